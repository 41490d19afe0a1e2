"""Controllers designed and judged on the nonlinear model."""
