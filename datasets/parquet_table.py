"""The same tables as Parquet files, for long drives."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from fgloc.datasets.columns import Columns, Layout, check_header, check_values, dtype_of, place
from fgloc.datasets.csv_table import read_csv, write_csv
from fgloc.errors import DriveError


def read_table(path: Path, layout: Layout) -> Columns:
    """The columns of a `.csv` or `.parquet` file; raises DriveError as `read_csv` does."""
    return read_parquet(path, layout) if path.suffix == ".parquet" else read_csv(path, layout)


def write_table(path: Path, columns: Mapping[str, ArrayLike]) -> None:
    """Write columns as `.csv` or `.parquet`, whichever the path ends in."""
    (write_parquet if path.suffix == ".parquet" else write_csv)(path, columns)


def read_parquet(path: Path, layout: Layout) -> Columns:
    """The columns of a Parquet file, each (N,) with N >= 1; raises DriveError like `read_csv`."""
    import pyarrow
    from pyarrow import parquet

    try:
        table = parquet.read_table(path)
    except FileNotFoundError as err:
        raise DriveError(f"{path}: no such file") from err
    except (OSError, pyarrow.ArrowException) as err:
        raise DriveError(f"{path}: not a readable Parquet file: {err}") from err
    check_header(str(path), table.column_names, layout)
    columns = {name: _column(path, name, table.column(name), layout) for name in table.column_names}
    check_values(path, columns, layout)
    return columns


def write_parquet(path: Path, columns: Mapping[str, ArrayLike]) -> None:
    """Write columns of one length under their names; int64 stamps, float64 everything else."""
    import pyarrow
    from pyarrow import parquet

    arrays = {name: np.asarray(values, dtype_of(name)) for name, values in columns.items()}
    parquet.write_table(pyarrow.table(arrays), path)


def _column(path: Path, name: str, column: Any, layout: Layout) -> Any:
    values = column.to_numpy()
    if column.null_count and not layout.may_be_empty(name):
        row = int(np.argmax(np.asarray(column.is_null())))
        raise DriveError(f"{place(path, row)}: {name} is empty; a number is needed")
    want = dtype_of(name)
    if values.dtype.kind not in {"i", want.kind}:
        raise DriveError(f"{path}: column {name} holds {column.type}, expected {want}")
    return values.astype(want)
