"""Objects that refuse to be copied."""

from typing import Any, ClassVar, NoReturn

from arm_emulator.base.refusal import Refusal


class NonCopyable:
    """Mixin that refuses `copy`, `deepcopy` and `pickle`.

    Attributes:
        instead: replaces a copy, for refusals.
    """

    instead: ClassVar[str]

    def __reduce_ex__(self, protocol: Any) -> NoReturn:
        raise Refusal(type(self).__name__, "the object", "stay one", "a copy", self.instead)
