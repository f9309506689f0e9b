"""Studies run over thousands of scenarios: chunks, results as tables, statistics."""
