"""A folder of Markdown files, each a prompt; read again when a file changes."""

from __future__ import annotations

from collections.abc import Callable, Sequence, Set
from contextlib import suppress
from functools import partial
from pathlib import Path

from ros2_mcp.prompts import markdown
from ros2_mcp.prompts.markdown import MAX_CHARACTERS, Parsed
from ros2_mcp.prompts.mistakes import Mistake, Tell
from ros2_mcp.prompts.prompt import Prompt

Parse = Callable[[str, str, str], Parsed]
_NOT_READ_YET = (("", -1, -1),)


class PromptFolder:
    """The prompts of one folder. `README.md` is ignored, and prompts with names in `taken` are refused.

    `parse` makes a prompt from a file's path, name and text; by default, files are prompts that may call `tools`. A
    missing folder is a mistake unless it `may_lack`.
    """

    def __init__(
        self,
        path: Path,
        tell: Tell,
        *,
        taken: Set[str] = frozenset(),
        tools: Set[str] = frozenset(),
        parse: Parse | None = None,
        may_lack: bool = False,
    ) -> None:
        self.path = path
        self._tell = tell
        self._taken = taken
        self._parse = parse or partial(markdown.parse, known_tools=tools)
        self._may_lack = may_lack
        self._seen: Sequence[tuple[str, int, int]] = _NOT_READ_YET
        self._announced = self._seen
        self._reported: Set[Mistake] = frozenset()
        self._prompts: Sequence[Prompt] = ()

    def prompts(self) -> Sequence[Prompt]:
        """Return the prompts of the current files."""
        if self._state() != self._seen:
            self._read()
        return self._prompts

    def has_news(self) -> bool:
        """Return whether a file was added, removed or changed since the prompts were read. Each change is reported
        once.
        """
        state = self._state()
        is_news = self._seen is not _NOT_READ_YET and state not in (self._seen, self._announced)
        self._announced = state
        return is_news

    def _files(self) -> list[Path]:
        return sorted(path for path in self.path.glob("*.md") if path.name.lower() != "readme.md")

    def _state(self) -> Sequence[tuple[str, int, int]]:
        """Return a value that differs whenever a file was added, removed or changed."""
        found: list[tuple[str, int, int]] = []
        for path in self._files():
            with suppress(OSError):  # it may have been removed since it was listed
                status = path.stat()
                found.append((path.name, status.st_mtime_ns, status.st_size))
        return tuple(found)

    def _read(self) -> None:
        self._seen = self._state()
        prompts: dict[str, Prompt] = {}
        mistakes: list[Mistake] = []
        for path in self._files():
            parsed = _parse_file(path, self._parse)
            mistakes += parsed.mistakes
            if parsed.prompt is None:
                continue
            if parsed.prompt.name in self._taken or parsed.prompt.name in prompts:
                mistakes.append(Mistake(str(path), parsed.line, f"The name {parsed.prompt.name} is already taken."))
            else:
                prompts[parsed.prompt.name] = parsed.prompt
        if not self.path.is_dir() and not self._may_lack:
            mistakes = [Mistake(str(self.path), 0, "There is no such folder of prompts.")]
        for mistake in mistakes:
            if mistake not in self._reported:
                self._tell(mistake)
        self._prompts, self._reported = list(prompts.values()), frozenset(mistakes)


def _parse_file(path: Path, parse: Parse) -> Parsed:
    try:
        text = path.read_text(encoding="utf-8-sig")
        if len(text) <= MAX_CHARACTERS:
            return parse(str(path), path.stem, text)
        problem = f"It is longer than {MAX_CHARACTERS} characters."
    except UnicodeDecodeError:
        problem = "It is not text in UTF-8."
    except OSError as error:
        problem = f"It cannot be read: {error.strerror}."
    return Parsed(None, 0, [Mistake(str(path), 0, problem)])
