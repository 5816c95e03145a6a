"""The common definitions, and a package of awkward ones."""

from support.awkward import codec, definitions

__all__ = ["codec", "definitions"]
