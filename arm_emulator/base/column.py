"""Numbers of rows of structs as named columns with units."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Rows = NDArray[np.void]


@dataclass(frozen=True)
class Column:
    """One number of each row.

    Attributes:
        path: names, the larger group first: ("measured", "current", "elbow").
        unit: "" if it has none.
        field: of the rows.
        member: of the field's structs; "": the field is numbers.
        place: of the number among those of the field.
    """

    path: tuple[str, ...]
    unit: str
    field: str
    member: str = ""
    place: tuple[int, ...] = ()

    @property
    def name(self) -> str:
        """Such as ``measured.current.elbow``."""
        return ".".join(self.path)

    @property
    def heading(self) -> str:
        """Its name with the unit, such as ``measured.current.elbow [A]``."""
        return f"{self.name} [{self.unit}]" if self.unit else self.name

    def select_values(self, rows: Rows) -> NDArray[Any]:
        """Return it for rows (K,)."""
        values: NDArray[Any] = rows[self.field]
        if self.member:
            values = values[self.member]
        for k in self.place:
            values = values[:, k]
        return values
