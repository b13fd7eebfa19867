"""Tables as text: CSV for spreadsheets, and Markdown for readers."""

import csv
import io
from collections.abc import Iterable, Mapping, Sequence


def csv_text(heads: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """A head line and the rows, each of which has a value for every head."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows([heads, *rows])
    return text.getvalue()


def records_csv(records: Sequence[Mapping[str, object]]) -> str:
    """Records as CSV: each key that one has is a column, the earliest first."""
    heads = list(dict.fromkeys(name for record in records for name in record))
    return csv_text(heads, ([record.get(head, "") for head in heads] for record in records))


def markdown_table(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table without an end of line."""
    lines = ["| " + " | ".join(cells) + " |" for cells in (heads, *rows)]
    return "\n".join([lines[0], "|" + "---|" * len(heads), *lines[1:]])
