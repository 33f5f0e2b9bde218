"""Errors of breplake, grouped by what a handler would do.

::

    BreplakeError                  anything raised on purpose; has a stable ``kind``
    ├── LakeError                  the lake itself: look at the path or the snapshot
    │   ├── LakeNotFoundError      (FileNotFoundError) no lake at that place
    │   ├── LakeFormatError        (ValueError) not a lake of a version we can read
    │   ├── NameNotFoundError      (LookupError) no such snapshot, tag, table or model
    │   ├── CommitConflictError    (RuntimeError) two writers claim the same models
    │   └── StorageError           (OSError) the lake cannot be written: no space, no permission
    ├── InputError                 (ValueError) one CAD file: becomes a row of ``failures``
    ├── KernelUnavailableError     (OSError) the CAD kernels cannot be loaded here
    ├── UsageError                 (ValueError) an argument breaks a rule
    │   └── RefusedSourceError     an archive that is not safe to read
    ├── SampleError            (RuntimeError) a loader could not make a sample
    ├── LimitError                 (RuntimeError) something took more than it was allowed
    └── MissingExtraError          (ImportError) an optional dependency is not installed

Every error says the rule, the value that broke it and the next step.  ``kind`` is
stable and append-only: it may be stored, counted and compared.
"""

from __future__ import annotations

__all__ = [
    "BreplakeError",
    "CommitConflictError",
    "InputError",
    "KernelUnavailableError",
    "LakeError",
    "LakeFormatError",
    "LakeNotFoundError",
    "LimitError",
    "MissingExtraError",
    "NameNotFoundError",
    "RefusedSourceError",
    "SampleError",
    "StorageError",
    "UsageError",
]


class BreplakeError(Exception):
    """Base of every error that breplake raises on purpose.

    Attributes
    ----------
    kind : str
        Stable code of the error, fit to be stored and counted.
    """

    kind: str = "error"


class LakeError(BreplakeError):
    """Something about the lake itself."""

    kind = "lake"


class LakeNotFoundError(LakeError, FileNotFoundError):
    """There is no lake at the given place."""

    kind = "lake-not-found"


class LakeFormatError(LakeError, ValueError):
    """The lake is of a version or shape that this breplake cannot read."""

    kind = "lake-format"


class NameNotFoundError(LakeError, LookupError):
    """No snapshot, tag, table or model of that name."""

    kind = "name-not-found"


class CommitConflictError(LakeError, RuntimeError):
    """Two writers added or replaced the same models."""

    kind = "commit-conflict"


class StorageError(LakeError, OSError):
    """The lake cannot be written: no space, no permission."""

    kind = "storage"


class InputError(BreplakeError, ValueError):
    """One CAD file cannot be turned into a model.

    Parameters
    ----------
    kind : str
        Stable code: see ``breplake.ingest.failure.KINDS``.
    message : str
        The rule, the value and the next step.
    """

    def __init__(self, kind: str, message: str) -> None:
        super().__init__(message)
        self.kind = kind

    def __reduce__(self) -> tuple[type[InputError], tuple[str, str]]:
        """Survive the way back from a worker process, where ``args`` alone is too short."""
        return type(self), (self.kind, str(self))


class KernelUnavailableError(BreplakeError, OSError):
    """Open CASCADE or Gmsh cannot be loaded, for want of a system library say."""

    kind = "kernel-unavailable"


class UsageError(BreplakeError, ValueError):
    """An argument breaks a rule."""

    kind = "usage"


class SampleError(BreplakeError, RuntimeError):
    """A loader could not make a sample, or the worker that made it died; names the model."""

    kind = "sample"


class RefusedSourceError(UsageError):
    """An archive is not safe to read, so nothing of it is."""

    kind = "refused-source"


class LimitError(BreplakeError, RuntimeError):
    """Something took more time, memory or room than it was allowed."""

    kind = "limit"


class MissingExtraError(BreplakeError, ImportError):
    """An optional dependency is not installed.

    Parameters
    ----------
    extra : str
        Name of the extra of the ``breplake`` package that brings it.
    need : str
        What was asked for, in the user's words.
    """

    kind = "missing-extra"

    def __init__(self, extra: str, need: str) -> None:
        super().__init__(f"{need} needs the extra '{extra}': pip install 'breplake[{extra}]'")
        self.extra = extra
        self.need = need

    def __reduce__(self) -> tuple[type[MissingExtraError], tuple[str, str]]:
        """Survive pickling, as :class:`InputError` does."""
        return type(self), (self.extra, self.need)
