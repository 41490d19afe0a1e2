"""Controllers and plants where users run them: C, Structured Text, FMU, python-control."""
