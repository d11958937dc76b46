"""Registries: the one list of each kind of part that users choose by name, or bring in a file of their own."""

from __future__ import annotations

import difflib
import hashlib
import importlib
import importlib.util
import inspect
import operator
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from types import ModuleType
from typing import Any, Generic, TypeVar

from hystfit.errors import HystfitError, ParameterError

T = TypeVar("T")


class Registry(Mapping[str, Callable[..., T]], Generic[T]):
    """Parts of one kind by name: noise models, estimators, identifiers, samplers.

    Names are known without importing anything; a part is imported when it is asked for. A user's own part needs no entry: it is
    named as my_file.py:MyClass, or passed as an object.

    Args:
        kind: what the parts are, for messages, such as "noise model".
        option: the argument that chooses one, such as "noise".
        base: "module:Class" that every part is an instance of.
        entries: "module:attribute" by name; the attribute makes the part when it is called.
    """

    def __init__(self, kind: str, option: str, base: str, entries: Mapping[str, str]):
        self.kind, self.option, self._base, self._entries = kind, option, base, dict(entries)

    def __iter__(self) -> Iterator[str]:
        return iter(self._entries)

    def __len__(self) -> int:
        return len(self._entries)

    def __getitem__(self, name: str) -> Callable[..., T]:
        return attribute(self._entries[name])

    @property
    def base(self) -> type:
        """The class of which every part is an instance."""
        return attribute(self._base)

    def find(self, choice: Any) -> Callable[..., T]:
        """What makes a part: of a name, of my_file.py:MyClass, or of a class."""
        if isinstance(choice, str):
            if choice in self._entries:
                return self[choice]
            if ".py:" in choice:
                path, _, name = choice.rpartition(":")
                return class_from_file(path, name, self.base)
        if isinstance(choice, type) and issubclass(choice, self.base):
            return choice
        hint = near(choice, self) if isinstance(choice, str) else ""
        raise ParameterError(
            f"{self.option} must be one of {', '.join(self)}, or my_file.py:MyClass; got {choice!r}{hint}"
        )

    def holds(self, choice: Any) -> bool:
        """Whether a class or an object is a part of this kind."""
        kind = choice if isinstance(choice, type) else type(choice)
        return issubclass(kind, self.base)

    def label(self, choice: Any) -> str:
        """A choice as text that `find` accepts: the name of an entry, or file.py:Class of a user's own class or object."""
        if isinstance(choice, str):
            path, _, name = choice.rpartition(":")
            return f"{Path(path).resolve()}:{name}" if path.endswith(".py") else choice
        kind = choice if isinstance(choice, type) else type(choice)
        named = [name for name, entry in self._entries.items() if entry == f"{kind.__module__}:{kind.__name__}"]
        return named[0] if named else f"{file_of(kind)}:{kind.__name__}"

    def make(self, choice: Any) -> T:
        """A part with its default settings; a part that is made already is returned as it is."""
        if isinstance(choice, self.base):
            return choice
        maker = self.find(choice)
        if isinstance(maker, type):
            refuse_unfinished(maker)
        return maker()


def near(name: str, known: Iterable[str]) -> str:
    """The known names that are spelled like `name`, as the end of a message: " (did you mean 'bouc-wen'?)"; "" where none is."""
    spelled = {entry.casefold(): entry for entry in known}
    close = difflib.get_close_matches(name.casefold(), spelled, n=3, cutoff=0.7)
    return f" (did you mean {' or '.join(repr(spelled[entry]) for entry in close)}?)" if close else ""


def attribute(place: str) -> Any:
    """What "module:name" refers to, imported now; the name may have dots."""
    module, _, name = place.partition(":")
    return operator.attrgetter(name)(importlib.import_module(module))


_PREFIX = "user_file_"
_executed: dict[tuple[Path, str], ModuleType] = {}  # files of the user's, by path and SHA-256 of what was run


def class_from_file(path: str, name: str, base: type, error: type[HystfitError] = ParameterError) -> type:
    """A class from a Python file of the user's. The file is executed, once in a process for the same content.

    Args:
        base: what the class must be derived from.

    Raises:
        HystfitError: the file cannot be read or run, or holds no such class; the message lists those that it holds.
    """
    file = Path(path).resolve()
    if not file.is_file():
        raise error(f"no file {path!r} with the class {name!r}")
    try:
        module = in_process(file) or _execute(file)
    except Exception as failure:
        raise error(f"{path} does not run: {type(failure).__name__}: {failure}") from failure
    found = getattr(module, name, None)
    if not (isinstance(found, type) and issubclass(found, base)):
        classes = [k for k, v in vars(module).items() if isinstance(v, type) and issubclass(v, base) and v is not base]
        raise error(f"{path} has no class {name!r} of this kind; it has {classes}{near(name, classes)}")
    return found


def _execute(file: Path) -> ModuleType:
    """Run a file as a module. Its text is run, never a compiled copy in __pycache__, which its SHA-256 does not cover."""
    source = file.read_bytes()
    place = hashlib.sha256(str(file).encode()).hexdigest()[:8]  # files of one name in two folders are two modules
    spec = importlib.util.spec_from_file_location(f"{_PREFIX}{file.stem}_{place}", file)
    if spec is None:
        raise ImportError("it is not a Python file")
    module = importlib.util.module_from_spec(spec)
    before = sys.modules.get(spec.name)
    sys.modules[spec.name] = module  # dataclasses and the saved description look up the module of a class there
    try:
        exec(compile(source, str(file), "exec", dont_inherit=True), vars(module))
    except BaseException:
        if before is None:
            del sys.modules[spec.name]
        else:
            sys.modules[spec.name] = before
        raise
    _executed[file, hashlib.sha256(source).hexdigest()] = module
    return module


def in_process(file: Path) -> ModuleType | None:
    """The module that this process already has of a file, as a script, by an import or by `class_from_file`; None where it has none.

    A file that has changed since `class_from_file` ran it counts as another one.
    """
    for module in list(sys.modules.values()):
        place = getattr(module, "__file__", None)
        imported = not getattr(module, "__name__", _PREFIX).startswith(_PREFIX)
        if imported and place and Path(place).name == file.name and Path(place).resolve() == file:
            return module
    return _executed.get((file, file_digest(file) or ""))


def code_digest(kind: type) -> str | None:
    """SHA-256 of the file of a class, as it was run; None for a class that was typed into an interpreter."""
    for (_, digest), module in _executed.items():
        if getattr(module, kind.__name__, None) is kind:
            return digest
    return file_digest(Path(file_of(kind)))


def file_digest(file: Path) -> str | None:
    """SHA-256 of a file; None where it cannot be read."""
    try:
        return hashlib.sha256(file.read_bytes()).hexdigest()
    except OSError:
        return None


def refuse_unfinished(kind: type, error: type[HystfitError] = ParameterError) -> None:
    """Refuse a class that lacks methods that its base class requires; the message names the class, its file and the methods."""
    missing = sorted(getattr(kind, "__abstractmethods__", ()))
    if missing:
        listed = " and ".join([", ".join(missing[:-1]), missing[-1]] if len(missing) > 1 else missing)
        raise error(
            f"{kind.__name__} in {file_of(kind)} has no {listed}: write what {kind.__mro__[1].__name__} declares"
        )


def file_of(kind: type) -> str:
    """The file that defines a class; "the session" for one that was typed into an interpreter."""
    try:
        return inspect.getfile(kind)
    except (TypeError, OSError):
        return "the session"
