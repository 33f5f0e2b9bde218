"""Models of a lake in the original file formats of the ABC dataset."""

from breplake.queries.abc.export import Exported, export

__all__ = ["Exported", "export"]
