"""The one exception that reaches a person."""

MAX_MESSAGE = 2000
"""Letters of a message; two paths of the usual length and advice take a quarter. What a file holds can have millions."""


class F4xError(Exception):
    """Bad input or an impossible request, reported in one clear sentence: which file, what is wrong, what to do.

    A message longer than `MAX_MESSAGE` loses its middle, so that the file at its start and the advice at its end stay.
    """

    def __init__(self, message: object = "") -> None:
        text = str(message)
        half = MAX_MESSAGE // 2
        super().__init__(text if len(text) <= MAX_MESSAGE else f"{text[:half]} … {text[-half:]}")


class Cancelled(Exception):  # noqa: N818 - nothing went wrong
    """The user asked a long job to stop; whatever was finished is on disk and can be resumed."""
