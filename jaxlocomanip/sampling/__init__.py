"""Random scenarios: distributions declared as data, drawn lane by lane, checked for what no planner could do."""
