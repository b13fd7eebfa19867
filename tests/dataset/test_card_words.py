"""Words that a user chose, on a dataset's card: names, titles, the licence."""

import json

import pytest
from markdown_it import MarkdownIt

from graycast.base.errors import GraycastError
from graycast.dataset.card import counts_all_scenes, escaped, fenced, spdx, stated_licence

HOSTILE = "a|b `c` *d* [e](javascript:f) <img src=x> # g_h_ & ~i~"


def test_words_of_the_user_are_shown_without_interpreting_markdown():
    """Oracle: an independent Markdown parser shows exactly the words that were written."""
    parser = MarkdownIt("commonmark").enable(["table", "strikethrough"])
    name = escaped(HOSTILE)
    tokens = parser.parse(f"| | |\n|---|---|\n| part {name} | 1 |\n\n# {name}")
    inline = [t for t in tokens if t.type == "inline" and HOSTILE[:1] in t.content]
    assert len(inline) == 2
    for token in inline:
        kinds = {child.type for child in token.children}
        assert kinds <= {"text", "text_special"}
        text = "".join(child.content for child in token.children)
        assert text.removeprefix("part ") == HOSTILE


def test_a_markdown_fence_is_longer_than_any_fence_in_its_text():
    text = "name: |\n  ```\n  ````\n"
    assert fenced(text).startswith("`````yaml\n")
    assert fenced("a: 1\n") == "```yaml\na: 1\n```"


@pytest.mark.parametrize(
    ("licence", "spelt"),
    [
        ("cc-by-4.0", "CC-BY-4.0"),
        ("mit OR apache-2.0", "MIT OR Apache-2.0"),
        ("LicenseRef-Ours",) * 2,
    ],
)
def test_a_licence_is_written_in_the_spelling_of_spdx(licence, spelt):
    assert spdx(licence) == spelt


@pytest.mark.parametrize(
    "words", ["ours", "Creative Commons", "CC BY 4.0", "", "MIT AND", "a\nb: c"]
)
def test_a_licence_unknown_to_spdx_is_refused(words):
    with pytest.raises(
        GraycastError, match=r"is not an SPDX expression: give an identifier of spdx.org/licenses"
    ):
        spdx(words)


@pytest.mark.parametrize(
    ("readme", "licence"),
    [
        ("---\npretty_name: bins\nlicense: MIT\ntags:\n- bop\n---\n# bins\n", "MIT"),
        ("---\nlicense: unknown\n---\n", None),
        ("---\nlicense: of my own\n---\n", None),
        ("---\nname: bins\n---\n\nlicense: MIT\n", None),
        ("# The owner's own\n", None),
    ],
)
def test_the_licence_of_a_card_is_read_from_its_header(readme, licence, tmp_path):
    assert stated_licence(tmp_path) is None
    (tmp_path / "README.md").write_text(readme)
    assert stated_licence(tmp_path) == licence


def test_a_card_that_counts_too_few_scenes_is_detected(tmp_path):
    """A run that is stopped after its scenes leaves the card of an earlier run of fewer."""
    for scene_id in range(3):
        (tmp_path / "train" / f"{scene_id:06d}").mkdir(parents=True)
    assert not counts_all_scenes(tmp_path)
    (tmp_path / "README.md").write_text("the owner's own")
    assert counts_all_scenes(tmp_path)
    (tmp_path / "card").mkdir()
    for count in (2, 3):
        (tmp_path / "card/stats.json").write_text(json.dumps({"scenes_in_dataset": count}))
        assert counts_all_scenes(tmp_path) == (count == 3)
