"""A folder of Markdown files, each a prompt; read again when something in it changes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence, Set
from pathlib import Path

from ros2_mcp.prompts.markdown import MAX_CHARACTERS, Parsed, parse
from ros2_mcp.prompts.mistakes import Mistake, Tell
from ros2_mcp.prompts.prompt import Prompt

_NOT_READ_YET = (("", -1, -1),)


class PromptFolder:
    """The prompts of one folder. `README.md` is not one of them; names in `taken` are not given away."""

    def __init__(self, path: Path, tell: Tell, *, taken: Set[str] = frozenset(), tools: Set[str] = frozenset()) -> None:
        self.path = path
        self._tell = tell
        self._taken = taken
        self._tools = tools
        self._seen: Sequence[tuple[str, int, int]] = _NOT_READ_YET
        self._announced = self._seen
        self._told: Set[Mistake] = frozenset()
        self._prompts: Sequence[Prompt] = ()

    def prompts(self) -> Sequence[Prompt]:
        """The prompts as the files are now."""
        if self._state() != self._seen:
            self._read()
        return self._prompts

    def has_news(self) -> bool:
        """Whether a file came, went or changed since the prompts were read; each change is news once."""
        state = self._state()
        is_news = self._seen is not _NOT_READ_YET and state not in (self._seen, self._announced)
        self._announced = state
        return is_news

    def _state(self) -> Sequence[tuple[str, int, int]]:
        return tuple(_stamps(self._files()))

    def _files(self) -> list[Path]:
        return sorted(path for path in self.path.glob("*.md") if path.name.lower() != "readme.md")

    def _read(self) -> None:
        self._seen = self._state()
        self._prompts, mistakes = _load(self._files(), self._taken, self._tools)
        if not self.path.is_dir():
            mistakes = [Mistake(str(self.path), 0, "There is no such folder of prompts.")]
        for mistake in mistakes:
            if mistake not in self._told:
                self._tell(mistake)
        self._told = frozenset(mistakes)


def _stamps(files: Sequence[Path]) -> Iterator[tuple[str, int, int]]:
    for path in files:
        try:
            status = path.stat()
        except OSError:
            continue
        yield path.name, status.st_mtime_ns, status.st_size


def _load(files: Sequence[Path], taken: Set[str], tools: Set[str]) -> tuple[list[Prompt], list[Mistake]]:
    prompts: dict[str, Prompt] = {}
    mistakes: list[Mistake] = []
    for path in files:
        parsed = _parse_file(path, tools)
        mistakes += parsed.mistakes
        if parsed.prompt is None:
            continue
        if parsed.prompt.name in taken or parsed.prompt.name in prompts:
            mistakes.append(Mistake(str(path), parsed.line, f"The name {parsed.prompt.name} is already taken."))
        else:
            prompts[parsed.prompt.name] = parsed.prompt
    return list(prompts.values()), mistakes


def _parse_file(path: Path, tools: Set[str]) -> Parsed:
    try:
        text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError:
        return _unusable(path, "It is not text in UTF-8.")
    except OSError as error:
        return _unusable(path, f"It cannot be read: {error.strerror}.")
    if len(text) > MAX_CHARACTERS:
        return _unusable(path, f"It is longer than {MAX_CHARACTERS} characters.")
    return parse(str(path), path.stem, text, tools)


def _unusable(path: Path, text: str) -> Parsed:
    return Parsed(None, 0, [Mistake(str(path), 0, text)])
