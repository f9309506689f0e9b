"""Rigid-body mechanics in SE(2)."""
