"""Controllers designed and evaluated on the nonlinear model."""
