"""What stands behind the measurement."""
