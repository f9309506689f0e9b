"""What people look at: recordings for the Rerun viewer, figures and summaries."""
