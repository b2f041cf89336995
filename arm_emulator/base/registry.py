"""Registries of classes by the names that they own; a class that inherits alone is in none."""

import importlib
import pkgutil
from collections.abc import Callable
from types import ModuleType
from typing import Any, Generic, TypeVar

from arm_emulator.base.refusal import Refusal

Kind = TypeVar("Kind")
Class = TypeVar("Class", bound=type)


class Registry(Generic[Kind]):
    """Classes of one kind, each registered where it is defined.

    Args:
        what: name of the kind in refusals, such as "part".
        package: whose modules register classes; they are imported when the registry is read.
        name_of: name that a class owns.
    """

    def __init__(self, kind_name: str, package: str, name_of: Callable[[Any], str]) -> None:
        self._kind_name = kind_name
        self._package = package
        self._name_of = name_of
        self._kinds: dict[str, type[Kind]] = {}
        self._complete = False

    def register(self, kind: Class) -> Class:
        """Register a class; for use as its decorator.

        Raises:
            Refusal: another class has its name, or the registry has been read.
        """
        where, name = f"{kind.__module__}.{kind.__qualname__}", self._name_of(kind)
        owner = self._kinds.get(name)
        if owner is not None:
            actual = f"a second beside {owner.__module__}.{owner.__qualname__}"
            raise Refusal(where, f"{self._kind_name} {name}", "have one owner", actual)
        if self._complete:
            rule = f"be registered before the {self._kind_name}s are read for the first time"
            raise Refusal(where, f"{self._kind_name} {name}", rule, "a class that comes later")
        self._kinds[name] = kind
        return kind

    def list_kinds(self) -> dict[str, type[Kind]]:
        """Return all classes by their names, in the order of their modules' names."""
        if not self._complete:
            package: ModuleType = importlib.import_module(self._package)
            for module in pkgutil.walk_packages(package.__path__, f"{self._package}."):
                importlib.import_module(module.name)
            self._complete = True
            in_order = sorted(
                self._kinds.items(), key=lambda item: (item[1].__module__.split(".")[-1], item[0])
            )
            self._kinds = dict(in_order)
        return dict(self._kinds)
