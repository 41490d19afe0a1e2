"""Drives of other shapes; to come."""

EFFECTS, UNKNOWN, ALIKE = {}, {}, ()
