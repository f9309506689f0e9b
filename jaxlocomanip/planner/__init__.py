"""The hierarchical adaptive motion planner."""
