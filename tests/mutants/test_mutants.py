"""Each of `mutants.txt` fits the source that it breaks."""

from try_mutants import ROOT, planted


def test_each_bug_can_be_put_in_and_has_tests():
    bugs = planted()
    assert len({bug.bug for bug in bugs}) == len(bugs) >= 100
    for bug in bugs:
        source = (ROOT / "src/graycast" / bug.file).read_text(encoding="utf-8")
        assert source.count(bug.text) == 1, bug.bug
        if bug.file.endswith(".py"):
            compile(source.replace(bug.text, bug.replaced_by), bug.file, "exec")
        for test in bug.tests.split():
            file, _, name = test.partition("::")
            assert f"def {name}" in (ROOT / "tests" / file).read_text(encoding="utf-8"), bug.bug
