"""Tables as text: CSV for spreadsheets, and Markdown for readers."""

import csv
import io
from collections.abc import Iterable, Mapping, Sequence


def csv_text(heads: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Return CSV text: a row of heads, then the rows, each with a value for every head."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows([heads, *rows])
    return text.getvalue()


def records_csv(records: Sequence[Mapping[str, object]]) -> str:
    """Return records as CSV, with a column for each key, in the order of first appearance."""
    heads = list(dict.fromkeys(name for record in records for name in record))
    return csv_text(heads, ([record.get(head, "") for head in heads] for record in records))


def markdown_table(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a Markdown table without a final line break."""
    lines = ["| " + " | ".join(cells) + " |" for cells in (heads, *rows)]
    return "\n".join([lines[0], "|" + "---|" * len(heads), *lines[1:]])
