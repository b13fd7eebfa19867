"""The command line: its options, its output, its files, and its exit codes."""

import argparse
import ast
import json
import os
import re
import shutil
import subprocess
import sys
from dataclasses import replace
from importlib.metadata import entry_points
from pathlib import Path

import numpy as np
import pytest
from backends import slow
from drawn import axes_of, figures_of, no_pixels
from PIL import Image
from small_cell import GRAYCAST, content, write_cell

from graycast import __version__
from graycast.base.errors import ConfigError
from graycast.camera.rig_file import load_scanner
from graycast.camera.rig_file.own import RigModel
from graycast.camera.scanner import preset
from graycast.camera.stack import StackDescription
from graycast.cell.config import Config
from graycast.cell.engine import TaskResult
from graycast.cell.framing import framing_line
from graycast.cell.resolve import load_cell
from graycast.cli import arguments, command, doctor, main, scene_commands, start_commands
from graycast.learn.study_file import StudySpec
from graycast.real.depth_file import DEPTH_FILES
from graycast.rendering.trial import Trial
from graycast.rig.pair import PRESETS
from graycast.robot.grasp_labels.label_options import ToolFile
from graycast.robot.pick.bin.pick_sections import PickConfig
from graycast.score.design.study import DesignSpec
from graycast.show.report import rig_picture as drawing
from graycast.show.report.page import WIDTH_PX
from graycast.world.drop import Decomposition

OPTIONS = {
    "demo": "--out --device",
    "new": "folder --part --builtin --unit --surface --surface-from",
    "preview": "config --out --scene --image --seed --backend --device",
    "generate": "config --out --scenes --seed --backend --device WORKERS",
    "rescan": "source --rig --resolution --out --camera --models --materials --sensor "
    "--depth-scale --intrinsics --ray-length --unit --depth-only --images --copy --seed --backend "
    "--device WORKERS",
    "live": "config --port --scene --open --device",
    "validate": "dataset --fast --workers",
    "report": "dataset --out --workers --detections --files --width",
    "parts": "config --out --device",
    "dataset stats": "dataset --out --workers --card --licence",
    "dataset export": "dataset --format --out --selection --shares --split-seed --picture "
    "--depth-files --polygons --labels --cloud --organised --pixel-origin --shard-scenes --link "
    "--min-visibility --workers",
    "dataset merge": "source --out",
    "dataset import": "folder --out --intrinsics --distortion --scale --size --ray-length "
    "--max-depth --annotations --unlabelled --like",
    "dataset rerender": "dataset --scene --files --device",
    "dataset grasps": "dataset --tool --name --per-instance --simulate --places --seed --files "
    "--workers",
    "dataset score-depth": "dataset --out",
    "detector train": "datasets --out --model --input --one-class --backbone --weights "
    "--longest-side --epochs --patience --batch --learning-rate --shares --split-seed "
    "--min-visibility --holes --no-relief --p-wrong --range --no-flips --seed --device --threads "
    "--readers",
    "detector find": "detector pictures --out --split --as-real --scale --max-detections "
    "--min-score --drawings --device --threads",
    "detector onnx": "detector --out --max-detections --min-score --device --threads",
    "detector score": "results SCORING --against --kind --one-class --max-per-class",
    "detector study": "study --out --list --device --threads",
    "robot pick": "config --out --bins --seed --device --detector --pose --depth WORKERS",
    "robot summary": "picks --out",
    "robot report": "picks --out --workers --width --files",
    "robot score-poses": "results SCORING",
    "rig list": "--field --at --noise",
    "rig show": "rig --resolution --out",
    "rig write": "rig --resolution --out",
    "rig import": "calibration --out --unit --near --far --camera-size --projector-size",
    "rig calibrate": "stacks --board --out --near --far --radial-terms",
    "rig hand-eye": "scans --poses --board --mount --rig --resolution --intrinsics --distortion "
    "--scale --ray-length --out --simulate --guess --corner-noise --robot-noise --seed",
    "rig patterns": "rig --resolution --out --codec --inverses",
    "rig decode": "stack --rig --resolution --average --motion --out",
    "rig certify": "rig --resolution --out --seed --backend --device",
    "rig design": "study --out --list --device WORKERS",
    "real measure": "depth --out --intrinsics --scale --size --ray-length --gray --reason",
    "real compare": "first second --out --intrinsics --scale --size --ray-length --classifier "
    "--max-maps --seed",
    "real twin": "scans --config --out --intrinsics --scale --size --ray-length --rgb --kept-aside "
    "--trials --seed --device",
    "real fit-bin": "views --config --out --rgb --intrinsics --distortion --scale --size "
    "--ray-length --inner --wall --azimuth --floor-reflectance --white --black --cluttered "
    "--pose-only --bend --seed --device",
    "real material": "stack --rig --resolution --mask --reference --reflectance --metal --out "
    "--seed",
    "doctor": "",
    "schema": "kind",
}
_SEVERAL = {
    "WORKERS": "--workers --threads --engine --address",
    "SCORING": "--on --out --split --shares --split-seed --min-visibility --resamples --seed",
}
OPTIONS = {
    name: " ".join(_SEVERAL.get(word, word) for word in words.split())
    for name, words in OPTIONS.items()
}
# Each flag of several commands is declared once, in the table of `cli.arguments`, except --out.
SHARED_FLAGS = """
--address --backend --board --config --device --distortion --engine --far --files --intrinsics
--list --max-detections --min-score --min-visibility --near --on --one-class --out --ray-length
--resamples --resolution --rgb --rig --scale --scene --seed --shares --simulate --size
--split --split-seed --threads
--unit --width --workers
""".split()
OUT = re.compile(r"The ((PNG|YAML|ONNX) file|folder)( to write| of the )")


def run(capsys, *arguments):
    """Return the output of a command that succeeds."""
    assert main([str(argument) for argument in arguments]) == 0
    printed, complaint = capsys.readouterr()
    assert complaint == ""
    return printed


def commands(parser, name=""):
    """Return every command with its parser, including those of groups."""
    groups = [a for a in parser._actions if isinstance(a, argparse._SubParsersAction)]
    if not groups:
        return {name.strip(): parser}
    return {
        key: subparser
        for word, inner in groups[0].choices.items()
        for key, subparser in commands(inner, f"{name} {word}").items()
    }


def test_every_command_has_exactly_the_listed_options():
    options_of = {
        name: [
            action.option_strings[-1] if action.option_strings else action.dest
            for action in parser._actions
            if action.dest not in ("help", "debug")
        ]
        for name, parser in commands(command._parser()).items()
    }
    assert options_of == {name: options.split() for name, options in OPTIONS.items()}


@pytest.mark.parametrize("name", ["fit-bin", "measure", "twin"])
def test_help_names_every_kind_of_depth_file(capsys, name):
    with pytest.raises(SystemExit):
        main(["real", name, "--help"])
    text = capsys.readouterr().out
    kinds = {suffix.removeprefix(".").upper()[:3] for suffix in DEPTH_FILES}
    assert {kind for kind in kinds if kind not in text} == set()


def test_help_names_the_older_layout_of_charuco_boards(capsys):
    with pytest.raises(SystemExit):
        main(["rig", "calibrate", "--help"])
    assert ":legacy" in capsys.readouterr().out


@pytest.mark.parametrize("name", OPTIONS)
def test_help_explains_every_option(capsys, monkeypatch, name):
    monkeypatch.setenv("COLUMNS", "100")
    with pytest.raises(SystemExit) as caught:
        main([*name.split(), "--help"])
    assert caught.value.code == 0
    _usage, *rest = capsys.readouterr().out.split("\n\n")
    lines = "\n".join(rest).splitlines()
    for option in OPTIONS[name].split():
        starts = [i for i, line in enumerate(lines) if re.match(rf"  {option}\b", line)]
        if not starts and not option.startswith("-"):  # Its choices explain it.
            starts = [i for i, line in enumerate(lines) if line.startswith("  {")]
        assert starts, f"{option} is not in the help"
        # The text is two blanks after the option, or on the next line, indented further.
        line, below, *_ = [*lines[starts[0] :], ""]
        words = line.strip().partition("  ")[2] or (below[:20].isspace() and below.strip())
        assert words, f"{option} is not explained"


def _rows_of_words(tree):
    """Return consecutive strings of calls and lists in a test."""
    for node in ast.walk(tree):
        is_list = isinstance(node, ast.List | ast.Tuple)
        items = node.args if isinstance(node, ast.Call) else node.elts if is_list else []
        words = [item.value if isinstance(item, ast.Constant) else "-" for item in items]
        yield f" {' '.join(map(str, words))} "
        if isinstance(node, ast.Attribute) and node.attr == "split":
            yield f" {node.value.value} " if isinstance(node.value, ast.Constant) else ""


@pytest.mark.slow
def test_each_command_is_run_by_a_test():
    files = Path(__file__).parents[1].rglob("test_*.py")
    texts = [text for file in files for text in _rows_of_words(ast.parse(file.read_text()))]
    run_by_none = {
        name for name in OPTIONS if not any(re.match(f"( -)* {name} ", text) for text in texts)
    }
    assert run_by_none == set()


def test_the_list_of_commands_is_short():
    assert len({name.split()[0] for name in OPTIONS}) <= 16 and len(OPTIONS) <= 42


def flags_of(name_and_parser):
    """Return each option of a command as `(command, flag, parsed type, help without default)`."""
    name, parser = name_and_parser
    for action in parser._actions:
        if action.option_strings and action.dest != "help":
            is_path = action.type is arguments.png_path  # a path that is refused early
            kind = (Path if is_path else action.type, action.metavar, action.nargs, action.choices)
            text = re.sub(r" \(default: .*\)", "", action.help)
            yield name, action.option_strings[-1], kind, text


def test_a_flag_has_the_same_meaning_type_and_metavar_in_all_commands():
    uses_of = {}
    for item in commands(command._parser()).items():
        for name, flag, kind, text in flags_of(item):
            uses_of.setdefault(flag, {})[name] = (kind, text)
    for flag, uses in uses_of.items():
        kinds, texts = ({use[i] for use in uses.values()} for i in (0, 1))
        assert len(kinds) == 1, f"{flag} is read in several ways: {uses}"
        if flag == "--out":
            assert {text for text in texts if not OUT.match(text)} == set()
        else:
            assert len(texts) == 1, f"{flag} has several meanings: {uses}"
    assert {f for f, uses in uses_of.items() if len(uses) > 1} == {"--debug", *SHARED_FLAGS}
    assert {*arguments.SHARED, "--out"} == {*SHARED_FLAGS}


@pytest.mark.parametrize(
    ("word", "meant"),
    [
        ("generat", "generate"),
        ("export", "dataset export"),
        ("trian", "detector train"),
        ("onnx", "detector onnx"),
    ],
)
def test_the_error_for_a_misspelt_command_names_the_right_one(capsys, word, meant):
    with pytest.raises(SystemExit):
        main([word])
    assert f"{word!r} does not exist: did you mean {meant}?" in capsys.readouterr().err


def test_a_former_command_names_its_replacement(capsys):
    with pytest.raises(SystemExit):
        main(["robot", "film", "out/picks", "--out", "film.gif"])
    message = capsys.readouterr().err
    assert "film is gone: graycast robot report writes a page" in message and "ffmpeg" in message


def test_the_help_states_the_default_width_of_the_library():
    assert scene_commands.WIDTH_PX == WIDTH_PX


def test_each_example_in_the_help_can_be_parsed():
    for name, parser in commands(command._parser()).items():
        first, example, *_ = parser.description.splitlines()
        assert first == "For example:" and example.startswith(f"  graycast {name}")
        command._parser().parse_args(example.partition(" > ")[0].split()[1:])
    for line in command.EXAMPLES.splitlines()[1:-1]:
        command._parser().parse_args(line.strip().split("  ")[0].split()[1:])


def test_the_help_names_the_index_of_the_documentation(capsys):
    with pytest.raises(SystemExit):
        main(["--help"])
    text = "".join(capsys.readouterr().out.partition("documentation:")[2].split())
    page = Path(text.partition("index.md")[0] + "index.md")
    assert page.is_file() and page.read_text(encoding="utf-8").startswith("# Graycast")


def test_help_consists_of_whole_sentences():
    """Each is understood alone; argparse's own text for --help is not ours."""
    for name, parser in commands(command._parser()).items():
        helps = {a.dest: a.help for a in parser._actions if a.dest != "help"}
        for option, text in (helps | {"": parser.description}).items():
            assert text[0].isupper() and text.endswith("."), f"{name} {option}: {text}"
            assert len(text.split()) >= 3, f"{name} {option}: {text}"


def test_help_lists_every_command_and_examples(capsys):
    with pytest.raises(SystemExit) as caught:
        main(["--help"])
    assert caught.value.code == 0
    text = capsys.readouterr().out
    for name in OPTIONS:
        assert re.search(rf"\n    {name.split()[0]}\s", text)
    assert "graycast generate bracket/cell.yaml --out data" in text


@pytest.mark.parametrize("group", ["dataset", "detector", "robot", "rig", "real"])
def test_a_group_prints_its_help_without_a_command(capsys, group):
    text = run(capsys, group)
    assert all(f"\n    {name.split()[1]}" in text for name in OPTIONS if f"{group} " in name)


def test_the_program_prints_its_help_without_a_command(capsys):
    assert run(capsys) == run_help(capsys)


def run_help(capsys):
    with pytest.raises(SystemExit) as end:
        main(["--help"])
    assert end.value.code == 0
    return capsys.readouterr().out


def test_thousands_of_threads_are_refused_with_a_clear_error(capsys, tmp_path):
    config, out = write_cell(tmp_path), tmp_path / "d"
    assert main(["generate", str(config), "--out", str(out), "--threads", "100000"]) == 1
    message = capsys.readouterr().err
    assert "error: threads is 100000 per worker; give 1 to 1024" in message
    assert not (tmp_path / "d").exists()


@pytest.mark.slow
def test_help_does_not_load_heavy_modules():
    program = """
import sys
from graycast.cli import main
try:
    main(["generate", "--help"])
except SystemExit:
    pass
heavy = {"mitsuba", "drjit", "numba", "trimesh", "scipy", "cv2", "matplotlib"}
sys.exit(f"loaded: {sorted(heavy & set(sys.modules))}" if heavy & set(sys.modules) else 0)
"""
    ran = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert (ran.returncode, ran.stderr) == (0, "")


@pytest.mark.slow
def test_the_installed_command_is_this_program_and_prints_its_version():
    (script,) = entry_points(group="console_scripts", name="graycast")
    assert script.load() is main
    output = subprocess.check_output([*GRAYCAST, "--version"], text=True)
    assert output == f"graycast {__version__}\n"


@pytest.mark.slow
def test_a_closed_pipe_causes_no_error():
    """For example, `head` in `graycast ... | head -1` closes the pipe after its line."""
    read, write = os.pipe()
    os.close(read)
    ran = subprocess.run(
        [*GRAYCAST, "--print-completion", "bash"], stdout=write, stderr=subprocess.PIPE, text=True
    )
    os.close(write)
    assert (ran.returncode, ran.stderr) == (1, "")


# --- results of commands ------------------------------------------------------------------------


@pytest.fixture(scope="module")
def cell_and_dataset(tmp_path_factory):
    folder = tmp_path_factory.mktemp("made")
    path = write_cell(folder)
    with no_pixels():  # The plots of the card need no pixels.
        assert main(["generate", str(path), "--out", str(folder / "out"), "--device", "cpu"]) == 0
    return path, folder / "out"


@pytest.mark.parametrize(
    ("workers", "text"),
    [(1, "about 0:00:30 and 0.02 GB"), (4, "about 0:00:08 and"), (0, "0.02 GB")],
)
def test_generate_estimates_time_and_disk_space_from_one_scene(tmp_path, workers, text):
    """Ten scenes of 3 s and 2 MB each; workers share the time, but not the disk."""
    first = TaskResult(
        scene_id=0, files=(("a", bytes(1_500_000)), ("b", bytes(500_000))), seconds=3.0,
        reasons={}, rss_bytes=0,
    )  # fmt: skip
    line = scene_commands._ahead(first, 10, workers, tmp_path)
    assert line.startswith(f"the other 10 scenes take {text}")
    huge = replace(first, files=(("a", bytes(1_000_000)),) * 100)
    assert "choose a larger disk" in scene_commands._ahead(huge, 10**9, workers, tmp_path)


@pytest.mark.parametrize("workers", [1, 2])
def test_the_estimated_time_ignores_the_first_scene_of_each_worker(
    tmp_path, monkeypatch, capsys, workers
):
    """A worker's first scene takes a minute, because it compiles; the others take 3 s each."""

    def generate(cell, out, *, on_result, **_):
        seconds = [60.0] * workers + [3.0] * (10 - workers)
        for k, duration in enumerate(seconds):
            (out / "train" / f"{k:06d}").mkdir(parents=True)
            on_result(
                TaskResult(
                    scene_id=k,
                    files=(("a", bytes(1000)),),
                    seconds=duration,
                    reasons={"decoded": 0.5},
                    rss_bytes=0,
                )
            )
        raise ConfigError("the test ends here")

    monkeypatch.setattr("graycast.cell.generate.generate", generate)
    path = write_cell(tmp_path)
    words = ["--out", str(tmp_path / "out"), "--scenes", "10", "--workers", str(workers)]
    assert main(["generate", str(path), *words, "--device", "cpu"]) == 1
    text = capsys.readouterr().out
    assert re.findall(r"the other (\d+) scenes take (?:about (\S+) and )?", text) == [
        ("9", ""),
        (str(9 - workers), f"0:00:{round((9 - workers) * 3 / workers):02d}"),
    ]


@pytest.mark.slow
def test_generate_reports_new_scenes_and_in_a_second_run_that_all_scenes_exist(
    capsys, cell_and_dataset, tmp_path
):
    path, out = cell_and_dataset
    card, text = out / "README.md", (out / "README.md").read_text()
    card.write_text("with a licence of its own")
    again = run(capsys, "generate", path, "--out", out, "--device", "cpu")
    assert card.read_text() == "with a licence of its own"
    card.write_text(text)
    assert "2 scenes of box by mitsuba on llvm, rig small, seed 0, 1 worker(s)" in again
    assert f"{out}: 0 scenes made, 2 were there" in again
    with no_pixels():
        first = run(
            capsys, "generate", path, "--out", tmp_path / "out", "--scenes", 1, "--device", "cpu"
        )
    assert f"{tmp_path / 'out'}: 1 scenes made, 0 were there" in first
    manifest = json.loads((tmp_path / "out/train/000000/manifest.json").read_text())
    lines = [line.split() for line in first.splitlines() if line.endswith("of all pixels")]
    for place, key in ((1, "part_reasons"), (-4, "reasons")):  # the parts' share first
        shares = {words[0]: float(words[place].rstrip("%")) for words in lines}
        assert shares == pytest.approx(
            {name: 100 * share for name, share in manifest[key].items()}, abs=0.006
        )
        assert sum(shares.values()) == pytest.approx(100, abs=0.04)


@pytest.mark.slow
def test_options_may_precede_the_configuration(cell_and_dataset, tmp_path, capsys):
    same = write_cell(tmp_path, scenes=7, seed=5)
    arguments = ("--out", tmp_path / "out", "--scenes", 2, "--seed", 0, "--device", "cpu")
    with no_pixels():
        run(capsys, "generate", same, *arguments)
    assert content(tmp_path / "out") == content(cell_and_dataset[1])


def test_validate_succeeds_for_a_valid_dataset(capsys, cell_and_dataset):
    assert run(capsys, "validate", cell_and_dataset[1]) == f"{cell_and_dataset[1]}: valid\n"


@pytest.mark.slow
def test_preview_draws_the_scene_and_counts_pixels_as_the_dataset_does(
    capsys, cell_and_dataset, tmp_path
):
    path, out = cell_and_dataset
    printed = run(
        capsys, "preview", path, "--out", tmp_path / "p.png", "--scene", 1, "--device", "cpu"
    )
    manifest = json.loads((out / "train/000001/manifest.json").read_text())
    of_parts, of_all = (manifest[key]["decoded"] for key in ("part_reasons", "reasons"))
    assert f"{of_parts:7.2%} of the parts' pixels, {of_all:7.2%} of all pixels" in printed
    assert f"\n{framing_line(load_cell(path).scene)}\n" in printed
    with Image.open(tmp_path / "p.png") as picture:
        assert min(picture.size) > 400
        assert np.std(np.array(picture.convert("L"))) > 10


@pytest.mark.slow
def test_the_command_parts_lists_built_in_or_configured_parts(capsys, cell_and_dataset):
    builtin = run(capsys, "parts")
    for name in ("metal_workpiece_1", "toothpaste", "yellow_salt_cube"):
        assert f"\n{name} " in builtin
    own = run(capsys, "parts", cell_and_dataset[0])
    assert "\nbox " in own
    assert "60.0 x 40.0 x 30.0" in own
    assert "72 g" in own  # 72 cubic centimetres of the default density, 1000 kg/m3
    assert "toothpaste" not in own
    scene = load_cell(cell_and_dataset[0]).scene
    assert f"\nwith {scene.rig.name}, {framing_line(scene)}\n" in own
    # The box's diagonal is 78.1 mm, and one hull is the box itself.
    assert "\n  box: 1, 0.00 mm (the bound is 0.78 mm)\n" in own
    # The box has three half rotations, and the mesh states none of them.
    assert own.count("note: ") == 1 and "note: box states no symmetry" in own


COARSE = "note: box: its collision hulls are too coarse: they are up to"


@pytest.mark.slow
def test_all_commands_that_use_coarse_hulls_print_a_note(
    capsys, cell_and_dataset, tmp_path, monkeypatch
):
    """The limit is set below the measured deviation, which is zero."""
    monkeypatch.setattr(Decomposition, "coarse", property(lambda self: True))
    assert COARSE in run(capsys, "parts", cell_and_dataset[0])
    cpu = ("--device", "cpu")
    assert COARSE in run(capsys, "preview", cell_and_dataset[0], "--out", tmp_path / "p.png", *cpu)
    output = run(
        capsys, "generate", cell_and_dataset[0], "--out", tmp_path / "out", "--scenes", 1, *cpu
    )
    assert COARSE in " ".join(output.split())


@pytest.mark.parametrize("name", PRESETS)
@pytest.mark.parametrize("resolution", ["low", slow("full")])
def test_a_preset_can_be_written_and_read_again(capsys, tmp_path, name, resolution):
    path = tmp_path / "rig.yaml"
    run(capsys, "rig", "write", name, "--resolution", resolution, "--out", path)
    rig, back = preset(name, resolution).rig, load_scanner(path).rig
    assert (back.camera, back.projector, back.name) == (rig.camera, rig.projector, rig.name)
    assert np.array_equal(back.T_cam_proj, rig.T_cam_proj)
    if (name, resolution) == ("paper", "low"):
        with no_pixels(), figures_of(drawing) as figures:
            output = run(capsys, "rig", "show", path, "--out", tmp_path / "rig.png")
        named = run(capsys, "rig", "show", name, "--resolution", resolution)
        figures_alone, heading, sources = named.partition("where its numbers are from:\n")
        assert output == f"{figures_alone}{tmp_path / 'rig.png'}\n"
        assert heading and "  baseline_m: 0.35  # source: header\n" in sources
        (figure,) = figures
        assert figure.get_suptitle().startswith("paper: baseline 350.0 mm")
        (baseline,) = (
            line
            for line in axes_of(figure)["from above (x, z)"].lines
            if line.get_label() == "baseline"
        )
        ends_mm = 1e3 * np.array([[0, 0], rig.T_cam_proj[[0, 2], 3]])
        assert np.allclose(baseline.get_xydata(), ends_mm)
        assert (tmp_path / "rig.png").is_file()


def test_rig_list_prints_each_preset_with_its_range_pixels_and_code(capsys):
    lines = run(capsys, "rig", "list").splitlines()
    assert [line.split()[0] for line in lines[:-2]] == list(PRESETS)
    assert (
        "0.46 to 1.12 m [source], baseline 350 mm [source], 2064 x 1544 pixels [source], code "
        "gray_phase [choice], field" in lines[2]
    )
    assert "[memory] recalled from a datasheet and not checked" in lines[-2]


def test_rig_list_filters_by_field_distance_and_noise(capsys):
    wish = ("--field", "0.6x0.4", "--at", "1")
    names = {line.split()[0] for line in run(capsys, "rig", "list", *wish).splitlines()}
    assert {"like-phoxi-m", "like-zivid-2-m70"} <= names and "like-phoxi-s" not in names
    assert "no scanner with a name fits" in run(capsys, "rig", "list", *wish, "--noise", "1e-9")
    assert main(["rig", "list", "--field", "0.6x0.4"]) == 1
    assert "add --at" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        main(["rig", "list", "--field", "600", "--at", "1"])
    assert "'600' is not two lengths in metres such as 0.6x0.4" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("command", "option", "value", "remedy"),
    [
        ("rig list", "--field", "600x400", "give 0.6x0.4"),
        ("rig list", "--at", "1000", "give 1"),
        ("rig list", "--noise", "0.2", "give 0.0002"),
        ("rig import", "--near", "450", "give 0.45"),
        ("rig import", "--far", "900.5", "give 0.9005"),
        ("real fit-bin", "--wall", "3", "give 0.003"),
        ("real fit-bin", "--inner", "600,400,200", "give 0.6,0.4,0.2"),
        ("rig decode", "--motion", "1,0,0.2", "give 0.001,0,0.0002"),
        ("rig decode", "--motion", "-1,0,0", "give -0.001,0,0"),
    ],
)
def test_a_length_given_in_millimetres_is_detected(command, option, value, remedy, capsys):
    with pytest.raises(SystemExit) as ending:
        main([*command.split(), f"{option}={value}"])
    message = capsys.readouterr().err
    assert ending.value.code != 0
    assert f"{option}: {value!r} is longer than" in message and message.strip().endswith(remedy)


def test_import_takes_unit_range_and_sizes_from_the_command_line(capsys, tmp_path):
    calibration, path = tmp_path / "stereo.yaml", tmp_path / "rig.yaml"
    calibration.write_text(
        "K1: [[900, 0, 320], [0, 901, 240], [0, 0, 1]]\n"
        "K2: [[800, 0, 400], [0, 801, 300], [0, 0, 1]]\n"
        "R: [[1, 0, 0], [0, 1, 0], [0, 0, 1]]\nT: [-8, 0, 0]\n"
        "D1: [0.1, 0, 0, 0]\nD2: [0, 0, 0, 0]\n"
    )
    size = ("--camera-size", "640x480", "--projector-size", "800x600")
    run(capsys, "rig", "import", calibration, "--out", path, "--unit", "mm", *size,
        "--near", "0.3", "--far", "0.9")  # fmt: skip
    rig = load_scanner(path).rig
    assert (rig.camera.width_px, rig.camera.height_px) == (640, 480)
    assert (rig.projector.width_px, rig.projector.height_px) == (800, 600)
    assert (rig.near_m, rig.far_m) == (0.3, 0.9)
    assert rig.T_cam_proj[:3, 3] == pytest.approx([0.008, 0, 0], abs=1e-15)
    assert rig.camera.distortion[0] == 0.1


@pytest.mark.parametrize("inverses", [False, True])
def test_patterns_count_columns_and_rows_in_gray_code(capsys, cell_and_dataset, tmp_path, inverses):
    """Oracle: bits of x ^ (x >> 1), most significant first, in the order of the file names."""
    rig, out = cell_and_dataset[0].parent / "rig.yaml", tmp_path / "patterns"
    listed = run(
        capsys, "rig", "patterns", rig, "--out", out, *(["--inverses"] if inverses else [])
    )
    *paths, stack = sorted(out.iterdir())
    assert listed.split() == [str(path) for path in (*paths, stack)]
    assert stack.name == "stack.yaml"
    images = [np.array(Image.open(path)) for path in paths]
    assert all(image.shape == (96, 128) and image.dtype == np.uint8 for image in images)
    white, black, *bits = images
    assert white.min() == 255
    assert black.max() == 0
    if inverses:
        assert all((bit == 255 - other).all() for bit, other in zip(*[iter(bits)] * 2, strict=True))
        bits = bits[::2]
    value = np.zeros((2, 96, 128), dtype=int)
    for k, bit in enumerate(bits):  # seven bits for 128 columns, seven for 96 rows
        value[k // 7] = 2 * value[k // 7] + (bit == 255)
    row, column = np.mgrid[0:96, 0:128]
    assert np.array_equal(value[0], column ^ (column >> 1))
    assert np.array_equal(value[1], row ^ (row >> 1))


@pytest.mark.parametrize(
    ("kind", "model"),
    [
        ("config", Config),
        ("rig", RigModel),
        ("stack", StackDescription),
        ("study", StudySpec),
        ("design", DesignSpec),
        ("robot", PickConfig),
        ("tool", ToolFile),
    ],
)
def test_the_command_schema_prints_json(capsys, kind, model):
    schema = model.model_json_schema()
    assert json.loads(run(capsys, "schema", kind)) == json.loads(json.dumps(schema))


@pytest.mark.slow
def test_the_last_line_of_doctor_is_its_verdict(capsys, monkeypatch):
    trial = Trial(device="llvm", seconds=0.0, denoiser="cpu")
    monkeypatch.setattr(doctor, "try_device", lambda device: trial)
    assert run(capsys, "doctor").splitlines()[-1].startswith(("ready", "not ready"))


@pytest.fixture
def another_doctor(monkeypatch):
    """Replace what a command does; a parser that was built before has the old function."""

    def put(run):
        monkeypatch.setattr(start_commands, "_doctor", run)
        monkeypatch.setattr(command, "_parser", command._parser.__wrapped__)

    return put


def test_ctrl_c_ends_with_code_130(capsys, another_doctor):
    def stop(options):
        raise KeyboardInterrupt

    another_doctor(stop)
    assert main(["doctor"]) == 130
    assert capsys.readouterr().err == "graycast: the command was stopped; nothing was written\n"


def test_an_error_of_several_lines_is_shown_in_one_line(capsys, another_doctor):
    def fail(options):
        raise ValueError("what is wrong:\n  this\n\nand that")

    another_doctor(fail)
    assert main(["doctor"]) == 1
    assert capsys.readouterr().err == "graycast: error: what is wrong: this and that\n"


ASK = r"""
source "$1"
shift
complete -p "$1" >/dev/null || exit 1
COMP_WORDS=("$@"); COMP_CWORD=$(($# - 1)); COMP_LINE="$*"; COMP_POINT=${#COMP_LINE}
"$(complete -p "$1" | sed 's/.*-F \([^ ]*\).*/\1/')" "$1" "${COMP_WORDS[COMP_CWORD]}"
printf '%s\n' "${COMPREPLY[@]}"
"""


@pytest.mark.parametrize(
    ("typed", "offered"),
    [
        (["gen"], ["generate"]),
        (["real", ""], ["compare", "fit-bin", "material", "measure", "twin"]),
        (["generate", "--ba"], ["--backend"]),
        (["generate", "--backend", "m"], ["mitsuba"]),
        (["generate", "cell"], ["cell.yaml", "cells"]),
        (["generate", "cell.yaml", "--out", "cells"], ["cells"]),
    ],
)
def test_bash_completes_commands_options_choices_and_files(capsys, tmp_path, typed, offered):
    if shutil.which("bash") is None:
        pytest.skip("needs bash, which is not here")
    (tmp_path / "graycast.bash").write_text(run(capsys, "--print-completion", "bash"))
    (tmp_path / "cell.yaml").touch()
    (tmp_path / "cells").mkdir()
    command = ["bash", "-c", ASK, "bash", "graycast.bash", "graycast", *typed]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True)
    assert sorted(done.stdout.split()) == offered


@pytest.mark.slow
@pytest.mark.parametrize(
    ("encoding", "name"),
    [
        ("ascii", "t\N{LATIN SMALL LETTER U WITH DIAERESIS}r.yaml"),
        slow("ascii", "t\udcfcr.yaml"),
        slow("utf-8", "t\udcfcr.yaml"),
    ],
)
def test_a_name_that_the_terminal_cannot_show_does_not_stop_a_finished_command(
    tmp_path, encoding, name
):
    """The names are German, and one has bytes that are not UTF-8, as in an old archive."""
    command = [sys.executable, "-m", "graycast", "rig", "write", "paper", "--out", name]
    environment = os.environ | {"PYTHONIOENCODING": encoding}
    run = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True)
    assert (run.returncode, run.stderr) == (0, b"")
    assert run.stdout.startswith(b"t") and run.stdout.rstrip().endswith(b"r.yaml")
    assert (tmp_path / name).exists()
