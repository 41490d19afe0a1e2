"""Declared models of geared drives."""

from dmptm_ctrl.drive.parameters import ERRATA, Drive, Quantity, paper_drive

__all__ = ["ERRATA", "Drive", "Quantity", "paper_drive"]
