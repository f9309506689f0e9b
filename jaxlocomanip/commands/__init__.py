"""Commands of the command line, one a module: their arguments, their refusals and what they do."""
