"""Ray on this machine: the results are those of one worker, even if a machine is lost."""

import os
import signal
import subprocess
import sys
import threading
import time
from contextlib import contextmanager
from pathlib import Path

import pytest
from small_cell import content, finished, start

from graycast.cell.engine.cluster import gpu_share
from graycast.cli import main
from graycast.dataset.check.checking import validate

RAY = Path(sys.executable).with_name("ray")
needs_ray = pytest.mark.skipif(not RAY.exists(), reason="Ray is missing: pip install 'ray>=2.40'")
PORT = 46379


def test_a_cluster_address_without_the_ray_engine_is_refused(config_file, tmp_path, capsys):
    out = str(tmp_path / "out")
    assert main(["generate", str(config_file), "--out", out, "--address", "127.0.0.1:1"]) == 1
    assert "--address applies only to a Ray cluster: add --engine ray" in capsys.readouterr().err


def test_the_error_without_an_installed_ray_names_the_remedy(
    config_file, tmp_path, capsys, monkeypatch
):
    monkeypatch.setitem(sys.modules, "ray", None)
    out = str(tmp_path / "out")
    assert main(["generate", str(config_file), "--out", out, "--engine", "ray"]) == 1
    assert "run pip install 'graycast[ray]', or use --engine local" in capsys.readouterr().err


@needs_ray
@pytest.mark.parametrize(
    ("resources", "threads", "scenes_on_a_gpu"),
    [
        ({"CPU": 16.0, "GPU": 1.0}, 1, 16),
        ({"CPU": 16.0, "GPU": 1.0}, 4, 4),
        ({"CPU": 48.0, "GPU": 4.0}, 1, 12),
        ({"CPU": 2.0, "GPU": 8.0}, 1, 1),  # more GPUs than processors
        ({"CPU": 3.0, "GPU": 1.0}, 1, 3),  # three thirds, rounded, fit on one GPU
    ],
)
def test_all_processors_of_a_cluster_share_its_gpus(resources, threads, scenes_on_a_gpu):
    share = gpu_share(resources, threads)
    assert int(1.0 / share) == scenes_on_a_gpu
    assert share * 1e4 == pytest.approx(round(share * 1e4))  # the smallest share in Ray


@pytest.mark.slow
def test_the_error_for_an_unreachable_cluster_names_it(config_file, tmp_path, capsys):
    command = ["generate", str(config_file), "--out", str(tmp_path / "out"), "--engine", "ray"]
    assert main([*command, "--address", "127.0.0.1:9"]) == 1
    message = capsys.readouterr().err
    assert "Ray at 127.0.0.1:9 does not answer" in message
    assert "start it with 'ray start --head', or check --address" in message
    assert {entry.name for entry in (tmp_path / "out").iterdir()} <= {".lock"}


@pytest.fixture
def cluster(monkeypatch):
    """Start two nodes of one processor each on this machine: a head, and one that may be lost."""
    monkeypatch.setenv("RAY_AUTH_MODE", "disabled")

    def node(*arguments):
        before = raylets()
        command = [RAY, "start", *arguments, "--num-cpus=1", "--disable-usage-stats"]
        subprocess.run(command, check=True, capture_output=True, timeout=100)
        (new,) = raylets() - before
        return new

    head = ["--head", "--node-ip-address=127.0.0.1", f"--port={PORT}", "--include-dashboard=false"]
    node(*head)
    try:
        yield f"127.0.0.1:{PORT}", node(f"--address=127.0.0.1:{PORT}")
    finally:
        subprocess.run([RAY, "stop", "--force"], capture_output=True, timeout=100)


def raylets():
    pids = set()
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            command = (folder / "cmdline").read_bytes().split(b"\0")[0]
        except OSError:
            continue
        if command.endswith(b"/raylet"):
            pids.add(int(folder.name))
    return pids


@contextmanager
def giving_up(process, seconds):
    """Kill a process that takes too long, so that the test does not wait for ever."""
    timer = threading.Timer(seconds, process.kill)
    timer.start()
    try:
        yield
    finally:
        timer.cancel()


SCENES = 60


@pytest.mark.slow
@needs_ray
def test_losing_a_cluster_node_during_a_run_loses_no_scene(
    cluster, config_file, undisturbed, tmp_path
):
    address, lost = cluster
    out = tmp_path / "out"
    command = ("generate", config_file, "--out", out, "--scenes", SCENES)
    with start(*command, "--engine", "ray", "--address", address) as run, giving_up(run, 600):
        while finished(out) < SCENES // 3 and run.poll() is None:
            time.sleep(0.02)
        assert run.poll() is None
        os.kill(lost, signal.SIGKILL)
        printed, complaint = run.communicate()
    assert run.returncode == 0, complaint
    assert f"{SCENES} scenes made, 0 were there" in printed
    assert content(out) == content(undisturbed(SCENES))
    assert validate(out) == ()
    assert not (out / "set_aside.json").exists()
    assert finished(out) == SCENES
