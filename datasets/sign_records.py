"""Sign records: what the text of a Smart Code stands for, as a JSON file.

The file maps each code, hexadecimal in lower case, to its sign:

    {"22a1": {"name": "curve", "p_world_m": [0, 0, 2.1], "normal_yaw_rad": -1.571,
              "size_m": 0.5588, "side": "right", "message": "curve in 100 m"}}
"""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from fgloc.config import validate
from fgloc.errors import ConfigError, DriveError, InputError, nearest
from fgloc.files import read_filled
from fgloc.infrastructure import Sign


class SignRecord(BaseModel):
    """One entry of the file."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)

    name: str = Field(min_length=1)
    p_world_m: list[float] = Field(min_length=3, max_length=3)
    normal_yaw_rad: float
    size_m: float = Field(gt=0)
    side: Literal["left", "right"] = "right"
    message: str = ""

    def sign(self, code: str) -> Sign:
        """The sign that bears the code."""
        fields = self.model_dump(exclude={"message", "p_world_m"})
        return Sign(code=code, p_world_m=np.array(self.p_world_m), **fields)


def read_sign_records(path: str | Path) -> dict[str, SignRecord]:
    """The records of a file by their codes.

    Raises DriveError with every fault of the first bad entry, or where a code is not lower-case
    hexadecimal or occurs twice.
    """
    path = Path(path)
    try:
        values = json.loads(read_filled(path), object_pairs_hook=_once)
    except ValueError as err:
        raise DriveError(f"{path}: not valid JSON: {err}") from err
    if not isinstance(values, dict):
        raise DriveError(f"{path}: expected an object that maps codes to signs")
    try:
        records = {
            code: validate(SignRecord, value, f"{path}: {code!r}") for code, value in values.items()
        }
        for code, record in records.items():
            record.sign(code)
    except ConfigError as err:
        raise DriveError(str(err)) from err
    except DriveError as err:
        raise DriveError(f"{path}: {err}") from err
    return records


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """An object of JSON; ValueError where a key occurs twice, of which the first would be lost."""
    values = dict(pairs)
    double = next((key for i, (key, _) in enumerate(pairs) if key in dict(pairs[:i])), None)
    if double is not None:
        raise ValueError(f"{double!r} occurs twice; keep one")
    return values


def record_of(code: str, records: Mapping[str, SignRecord]) -> SignRecord:
    """The record of a code; InputError that names the code and the nearest known one."""
    if code in records:
        return records[code]
    if not records:
        raise InputError(f"Smart Code {code!r}: there are no sign records")
    raise InputError(
        f"Smart Code {code!r} has no sign record; the nearest is {nearest(code, records)!r} "
        f"(there are: {', '.join(records)}): add it to the file of records or leave the sign out"
    )
