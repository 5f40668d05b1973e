"""Errors of files and their content."""

from __future__ import annotations


class SolaspectError(Exception):
    """A file that cannot be used, by itself or for its content.

    Arguments of a wrong type, shape or value are a `TypeError` or `ValueError` that begins with the argument's name.

    Attributes
    ----------
    file : str or None
        The file that the error is about.
    field : str or None
        The key, keyword or column in that file.
    """

    def __init__(self, message: str, file: str | None = None, field: str | None = None) -> None:
        super().__init__(message)
        self.file = file
        self.field = field

    def __reduce__(self) -> tuple[type[SolaspectError], tuple[str, str | None, str | None]]:
        return type(self), (str(self), self.file, self.field)
