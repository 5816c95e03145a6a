"""All functions that only programs have. A module that declares some is one line here."""

from collections.abc import Sequence

from ros2_mcp.programs import functions  # isort: split

# Functions are shown in the order of declaration: the most used first.
from ros2_mcp.programs import arrays
from ros2_mcp.programs.declare import DECLARED, Function, pure
from ros2_mcp.programs.numbers import NUMBERS

__all__ = ["FUNCTIONS", "arrays", "functions"]

FUNCTIONS: Sequence[Function] = [*DECLARED, *(pure(name, implementation) for name, implementation in NUMBERS.items())]
"""In the order in which they are shown. Those of `functions` and `arrays` were declared when these were imported."""
