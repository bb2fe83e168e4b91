"""What the report measures: a module a group of questions, and the worlds, protocols and published rows that they share."""
