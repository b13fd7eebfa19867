"""The page of benchmarks: its headings, its wrapped text, and its tables, which are not wrapped."""

from argparse import Namespace

from benchmarks import __main__ as program
from benchmarks import page
from graycast.base.tables import markdown_table


def test_a_page_has_its_sections_in_order_and_does_not_wrap_tables(monkeypatch, tmp_path, capsys):
    rows = markdown_table(["a", "b"], [["x" * 80, "y" * 80]])

    def sections(circumstances, commit, names):
        yield "Benchmarks", f"on {circumstances['date']}"
        yield "Drop", "word " * 40 + "\n\n" + rows

    monkeypatch.setattr(page, "page", sections)
    out = tmp_path / "page.md"
    assert program.run_page(Namespace(out=out, sections=[])) == 0
    text = out.read_text()
    assert text.startswith("# Benchmarks\n\non 20") and "\n## Drop\n\n" in text
    assert rows.splitlines()[2] in text.splitlines()
    assert max(len(line) for line in text.splitlines() if not line.startswith("|")) <= 120
    assert str(out) in capsys.readouterr().out


def test_chosen_sections_are_printed_and_no_page_is_written(monkeypatch, tmp_path, capsys):
    monkeypatch.setitem(page.SECTIONS, "drops", ("Dropping parts", lambda: "as measured"))
    assert program.main(["page", "drops", "--out", str(tmp_path / "page.md")]) == 0
    assert "## Dropping parts\n\nas measured" in capsys.readouterr().out
    assert list(tmp_path.iterdir()) == []
    assert program.main(["page", "nap"]) == 2
    assert "no section nap: choose from rendering, drops" in capsys.readouterr().err
