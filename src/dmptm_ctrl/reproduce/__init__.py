"""Every figure and table of the paper, in one command: ``dmptm reproduce``."""

from dmptm_ctrl.reproduce.run import reproduce

__all__ = ["reproduce"]
