"""New logs against a model: whether it is still the same machine, and what has moved."""
