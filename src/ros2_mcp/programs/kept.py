"""Kept programs: a folder of Markdown files, each with a program, its description and its inputs.

A file is written by `ros2_program_save` or by hand. It has the name of its program, so that the program is found
without reading other files. Former versions are kept in the folder `former`.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from anyio import to_thread

from ros2_mcp.model.argument_entries import arguments_under
from ros2_mcp.model.arguments import Argument, values_of
from ros2_mcp.model.errors import BadData, BadInput, NotFound, RobotError
from ros2_mcp.model.front_matter import Entry, FrontMatterError, split
from ros2_mcp.model.names import did_you_mean
from ros2_mcp.model.text import excerpt, is_unicode, quoted
from ros2_mcp.robot import Robot
from ros2_mcp.robot.kept import Kept
from ros2_mcp_common.files import replace

FORMER = "former"
"""The folder, within the folder of programs, of former versions."""
MAX_BYTES = 100_000
"""The longest file that is read, far longer than the programs that agents write."""
MAX_PROGRAMS = 500
"""More programs than a person reads through; listing them takes a second at most."""
_MOST_FORMER = 20
"""The most former versions of each program: as many changes as a user may want to revert."""
_MOST_DESCRIPTION = 1000
_KEYS = ("description", "inputs", "version", "saved", "by")
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,63}")
_NAMES = "letters, digits, _ and -, at most 64"
_CODE = re.compile(r"^(?P<fence>`{3,})python[ \t]*\n(?P<code>.*?)^(?P=fence)[ \t]*$", re.MULTILINE | re.DOTALL)


@dataclass(frozen=True, slots=True, kw_only=True)
class KeptProgram:
    """One program. `version` counts from 1. `saved` (ISO 8601) and `by` (the client) are empty if it was written by
    hand.
    """

    name: str
    description: str
    code: str
    inputs: Sequence[Argument] = ()
    version: int = 1
    saved: str = ""
    by: str = ""

    def checked(self, given: Mapping[str, Any]) -> dict[str, Any]:
        """Return a value for every input: the given value, checked, or the default. A text without either is empty.

        Raises:
            BadInput: for an unknown, missing or wrong input.
        """
        texts = {name: _as_text(value) for name, value in given.items()}
        values = values_of(self.inputs, texts, f"The program {self.name}", "input")
        empty = {each.name: "" for each in self.inputs if each.kind == "string" and values[each.name] is None}
        return values | empty


@dataclass(frozen=True, slots=True)
class Mistake:
    """A mistake in a file: the line, or 0 for the whole file, and the reason."""

    file: str
    line: int
    text: str

    def __str__(self) -> str:
        return f"{self.file}:{self.line}: {self.text}" if self.line else f"{self.file}: {self.text}"


class KeptPrograms(Kept):
    """The programs of one folder. Files are read at each call, because people and other servers write there, too."""

    def __init__(self, folder: Path | None) -> None:
        self._folder = folder.expanduser() if folder else None

    @property
    def folder(self) -> Path | None:
        """The folder of the programs; None if this server keeps none."""
        return self._folder

    def names(self) -> list[str]:
        """Return the names of all files that may be programs."""
        if self._folder is None:
            return []
        names = sorted(path.stem for path in self._folder.glob("*.md") if _NAME.fullmatch(path.stem))
        return [name for name in names if name.lower() != "readme"][:MAX_PROGRAMS]

    def all(self) -> tuple[list[KeptProgram], list[Mistake]]:
        """Return all programs in the order of their names, and the mistakes in other files."""
        programs: list[KeptProgram] = []
        mistakes: list[Mistake] = []
        for name in self.names():
            found = self._read(name)
            if isinstance(found, KeptProgram):
                programs.append(found)
            elif found:  # None: it was removed meanwhile
                mistakes.append(found)
        return programs, mistakes

    def find(self, name: str) -> KeptProgram:
        """Return the program of that name.

        Raises:
            NotFound: with the most similar name.
            BadData: if its file is not a valid program.
        """
        found = self._read(name)
        if isinstance(found, KeptProgram):
            return found
        if found:
            raise BadData(f"The kept program {name} cannot be used: {found}", "Fix or remove its file.")
        hint = did_you_mean(name, self.names(), "ros2_program_list shows them.")
        raise NotFound(f"There is no kept program {quoted(name)}.", hint)

    async def resolve(self, program: str, inputs: Mapping[str, Any]) -> tuple[str, Mapping[str, Any]]:
        """Return the code to run and its inputs. A text that is only a name is the name of a kept program.

        Raises:
            NotFound, BadData: as `find`.
            BadInput: as `KeptProgram.checked`.
        """
        name = program.strip()
        if not _NAME.fullmatch(name):
            return program, inputs
        kept = await to_thread.run_sync(self.find, name)
        return kept.code, kept.checked(inputs)

    def former_file(self, program: KeptProgram) -> Path:
        """Return the file in which a program is kept after it was replaced or removed."""
        return self._file(program.name).parent / FORMER / f"{program.name}.v{program.version}.md"

    def save(self, program: KeptProgram, *, overwrite: bool) -> tuple[KeptProgram, KeptProgram | None]:
        """Keep a program. Return it with its new version, and the program that it replaces, or None.

        Raises:
            BadInput: for an invalid name, description or input, or if the name exists and `overwrite` is false.
            BadData: if the file of that name is not a valid program.
            RobotError: if the file cannot be written, or this server has no folder for it.
        """
        self._check(program)
        former = self._read(program.name)
        if isinstance(former, Mistake):
            raise BadData(f"{former}", "The file is not overwritten: repair it or move it away by hand.")
        if former and not overwrite:
            raise BadInput(
                f"There is a program {program.name} already (version {former.version}): {excerpt(former.description)}",
                "Give replace=true for a new version of it, or another name.",
            )
        if former is None and len(self.names()) >= MAX_PROGRAMS:
            raise BadInput(
                f"{MAX_PROGRAMS} programs are kept already.", "Remove one: ros2_program_save with remove=true."
            )
        version = 1 + max(former.version if former else 0, *self._former_versions(program.name), 0)
        kept = KeptProgram(
            name=program.name,
            description=" ".join(program.description.split()),
            code=program.code.strip("\n") + "\n",
            inputs=program.inputs,
            version=version,
            saved=program.saved,
            by=program.by,
        )
        text = text_of(kept)
        again = parse(self._file(kept.name), kept.name, text)
        if isinstance(again, Mistake):
            raise BadInput(f"This cannot be kept: {again.text}")
        if former:
            self._put_away(former)
        self._write(self._file(kept.name), text)
        return again, former

    def remove(self, name: str) -> KeptProgram:
        """Move a program to the folder `former`. Raises as `find` and `save`."""
        found = self.find(name)
        self._put_away(found)
        return found

    def _check(self, program: KeptProgram) -> None:
        if not _NAME.fullmatch(program.name) or program.name.lower() == "readme":
            raise BadInput(f"{quoted(program.name)} is not a valid name for a program.", f"Use {_NAMES}.")
        if not program.code.strip():
            raise BadInput("There is no program to keep.", "Give program.")
        if not program.description.strip() or len(program.description) > _MOST_DESCRIPTION:
            raise BadInput(f"A description has 1 to {_MOST_DESCRIPTION} characters: say what the program is for.")
        if not is_unicode(program.code + program.description):
            raise BadInput("The program or its description is not a text that can be written.")

    def _file(self, name: str) -> Path:
        if self._folder is None:
            raise RobotError("This server keeps no programs.", "Start it with --programs DIR.")
        return self._folder / f"{name}.md"

    def _read(self, name: str) -> KeptProgram | Mistake | None:
        if self._folder is None or not _NAME.fullmatch(name):
            return None
        path = self._file(name)
        try:
            with path.open("rb") as opened:
                data = opened.read(MAX_BYTES + 1)
            text = data.decode("utf-8-sig")
        except (FileNotFoundError, NotADirectoryError):
            return None
        except OSError as error:
            return Mistake(str(path), 0, f"It cannot be read: {error.strerror}.")
        except UnicodeDecodeError:
            return Mistake(str(path), 0, "It is not text in UTF-8.")
        if len(data) > MAX_BYTES:
            return Mistake(str(path), 0, f"It is longer than {MAX_BYTES} bytes.")
        return parse(path, name, text.replace("\r\n", "\n"))

    def _former_versions(self, name: str) -> list[int]:
        found = self._file(name).parent.glob(f"{FORMER}/{name}.v*.md")
        return sorted(int(digits) for path in found if (digits := path.stem.rpartition(".v")[2]).isdigit())

    def _put_away(self, program: KeptProgram) -> None:
        """Move a file to the folder `former`, and remove the oldest files there beyond `_MOST_FORMER`."""
        former = self.former_file(program)
        try:
            former.parent.mkdir(exist_ok=True)
            replace(self._file(program.name), former)
            for version in self._former_versions(program.name)[:-_MOST_FORMER]:
                former.with_name(f"{program.name}.v{version}.md").unlink(missing_ok=True)
        except OSError as error:
            raise RobotError(f"The former version of the program cannot be stored: {error}.") from error

    def _write(self, file: Path, text: str) -> None:
        draft = file.with_name(f".{file.name}.draft")
        try:
            file.parent.mkdir(parents=True, exist_ok=True)
            draft.write_text(text, encoding="utf-8", newline="\n")
            replace(draft, file)
        except OSError as error:
            raise RobotError(f"The program cannot be written: {error}.") from error


def programs_of(robot: Robot) -> KeptPrograms:
    """Return the kept programs of a robot; an empty collection if it was built without a folder."""
    return robot.kept.get(KeptPrograms, lambda: KeptPrograms(None))


def parse(where: Path, name: str, text: str) -> KeptProgram | Mistake:
    """Parse the text of a file of that name. Return the program, or its mistake."""
    try:
        front, body, first_line = split(text)
        front.check_keys(_KEYS)
        inputs = tuple(arguments_under(front, "inputs"))
        version = _version(front)
        description, saved, by = front.text("description"), front.text("saved"), front.text("by")
    except FrontMatterError as error:
        return Mistake(str(where), error.line, error.text)
    codes = list(_CODE.finditer(body))
    if len(codes) != 1:
        problem = "There is no program: a block between lines of ```python and ```." if not codes else "Two programs."
        return Mistake(str(where), first_line, problem)
    if not description:
        return Mistake(str(where), front.line_of("description"), "There is no description: say what it is for.")
    return KeptProgram(
        name=name, description=description, code=codes[0]["code"], inputs=inputs, version=version, saved=saved, by=by
    )


def _version(front: Entry) -> int:
    version = front.number("version", 1)
    if not 1 <= version <= 1e9 or version % 1:
        raise FrontMatterError(front.line_of("version"), "version must be a number that counts from 1.")
    return int(version)


def text_of(program: KeptProgram) -> str:
    """Return the text of a program's file. Values in the front matter are JSON, which is also YAML."""
    front = [f"description: {_written(program.description)}"]
    if program.inputs:
        front.append("inputs:")
    for argument in program.inputs:
        front.append(f"  - name: {argument.name}")
        front.append(f"    type: {argument.kind}")
        front += [f"    {key}: {_written(value)}" for key, value in _declared(argument).items()]
    front.append(f"version: {program.version}")
    front += [f"{key}: {_written(value)}" for key, value in (("saved", program.saved), ("by", program.by)) if value]
    longest = max((len(found) for found in re.findall(r"^`+", program.code, re.MULTILINE)), default=0)
    fence = "`" * max(3, longest + 1)
    return "\n".join(["---", *front, "---", "", f"{fence}python", f"{program.code}{fence}", ""])


def _declared(argument: Argument) -> dict[str, Any]:
    """Return the attributes of an argument that differ from their defaults."""
    found: dict[str, Any] = {}
    if argument.description:
        found["description"] = argument.description
    if argument.required:
        found["required"] = True
    if argument.default is not None:
        found["default"] = _as_text(argument.default) if argument.kind == "json" else argument.default
    if argument.choices:
        found["choices"] = [_as_text(choice) for choice in argument.choices]
    bounds = {"minimum": argument.minimum, "maximum": argument.maximum}
    return found | {key: bound for key, bound in bounds.items() if abs(bound) != float("inf")}


def _written(value: Any) -> str:
    return json.dumps(value, ensure_ascii=False)


def _as_text(value: Any) -> str:
    """Return a value as it is written in an argument of a prompt."""
    return value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)
