"""The one exception that reaches a person."""


class F4xError(Exception):
    """Bad input or an impossible request, reported in one clear sentence: which file, what is wrong, what to do."""


class Cancelled(Exception):  # noqa: N818 - nothing went wrong
    """The user asked a long job to stop; whatever was finished is on disk and can be resumed."""
