"""Latency, start-up and throughput of the planner on this machine: `python -m benchmarks`."""
