"""Child processes: the worker's verbs as jobs that a timer polls, and the preferences that find its Python."""
