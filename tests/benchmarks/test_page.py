"""The page of benchmarks: headings, wrapped text, and tables as they are."""

from argparse import Namespace

from benchmarks import __main__ as program
from benchmarks.page import table


def test_a_page_has_its_sections_in_order_and_does_not_wrap_tables(monkeypatch, tmp_path, capsys):
    rows = table(["a", "b"], [["x" * 80, "y" * 80]])

    def sections(root, circumstances, commit):
        yield "Benchmarks", f"on {circumstances['date']}"
        yield "Drop", "word " * 40 + "\n\n" + rows

    monkeypatch.setattr(program, "page", sections)
    out = tmp_path / "page.md"
    assert program.run_page(Namespace(out=out)) == 0
    text = out.read_text()
    assert text.startswith("# Benchmarks\n\non 20") and "\n## Drop\n\n" in text
    assert rows.splitlines()[2] in text.splitlines()
    assert max(len(line) for line in text.splitlines() if not line.startswith("|")) <= 120
    assert str(out) in capsys.readouterr().out
