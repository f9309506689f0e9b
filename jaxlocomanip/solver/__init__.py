"""Sequential quadratic programming for optimal control; knows nothing of robots."""
