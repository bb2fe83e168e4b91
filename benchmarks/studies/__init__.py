"""Studies of the report: a module for each group of questions, and the worlds, protocols and published rows that they share."""
