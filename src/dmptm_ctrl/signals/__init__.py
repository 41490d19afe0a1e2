"""Logs: signals on one clock, measured or simulated, and how they come in."""

from dmptm_ctrl.signals.campaign import Campaign
from dmptm_ctrl.signals.columns import Column
from dmptm_ctrl.signals.dialect import TextFormat
from dmptm_ctrl.signals.errors import LogError, MissingChannelError
from dmptm_ctrl.signals.loaders import load_log, load_logs
from dmptm_ctrl.signals.log import Log

__all__ = [
    "Campaign",
    "Column",
    "Log",
    "LogError",
    "MissingChannelError",
    "TextFormat",
    "load_log",
    "load_logs",
]
