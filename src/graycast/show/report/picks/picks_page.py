"""Build the page of a folder of picks: shared data, and a piece for each bin."""

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from ....base.folder import write_whole
from ....base.progress import UNWATCHED, ProgressMeter
from ....base.version import __version__
from ....robot.pick import StoredEpisode, read_episodes, summarize
from ....robot.pick.results.replay import Replay, open_replay
from ..page import WIDTH_PX, ReportSummary
from ..page.packing import color_table, report_script, view_record
from ..page.pieces import Web, write_pieces, write_web, writing_page
from ..page.walls import open_bin, packed_mesh
from .bin_files import BinPiece, bin_key
from .bodies import look, table
from .words import outcome_words

_WEB = Web(
    package=__package__,
    title="Graycast picks",
    home="all bins (Esc)",
    styles=("picks.css",),
    scripts=(
        *("geometry.js", "paint.js", "shapes.js", "cloud.js"),  # shared with the dataset's page
        *("outcomes.js", "bins.js", "bodies.js", "state.js", "scans.js"),
        *("attempts.js", "player.js", "layers.js", "replay.js"),
    ),
)


def write_pick_report(
    picks: Path,
    out: Path,
    *,
    cell_folder: Path,
    workers: int = 1,
    width_px: int = WIDTH_PX,
    progress: ProgressMeter = UNWATCHED,
) -> ReportSummary:
    """Write the page of a folder of picks, or update it; see `write_report`.

    Args:
        cell_folder: see `folder` of `open_replay`.

    Raises:
        GraycastError: there is no bin, a bin is damaged, or `out` holds something else.
    """
    episodes = read_episodes(picks)
    summary = summarize(episodes)
    replay = open_replay(picks, folder=cell_folder)
    pieces = [
        BinPiece(out=picks, cell_folder=cell_folder, episode=episode, width_px=width_px)
        for episode in episodes
    ]
    with writing_page(out, picks):
        done = write_pieces(out, pieces, workers=workers, what="bins", progress=progress)
        content = {
            "name": picks.resolve().name,
            "graycast": __version__,
            "claim": {
                **{key: replay.claim[key] for key in ("config", "seed", "versions")},
                "rig": replay.cell.cell.scene.rig.name,
            },
            "colormaps": {name: color_table(name) for name in ("viridis_r", "RdBu_r")},
            "reasons": [],
            "outcomes": outcome_words(),
            "summary": {
                **asdict(summary),
                "thinking_s": summary.thinking_s,
                "picks_per_hour": summary.picks_per_hour,
                "picks_per_hour_here": summary.picks_per_hour_here,
            },
            **_cell(replay),
            "bins": _bins(episodes),
        }
        write_whole(out / "index.js", report_script(content))
        write_web(out, _WEB)
    return done


def _cell(replay: Replay) -> dict[str, Any]:
    """Return the fixed bodies, all meshes, and the viewpoints of the scanner and of the user."""
    scene = replay.cell.cell.scene
    return {
        "view": view_record(scene.rig.camera, scene.T_world_cam),
        "limbs": [
            {"is_tool": i >= replay.arm_limbs, **packed_mesh(limb)}
            for i, limb in enumerate(replay.limbs)
        ],
        "parts": [{"name": part.name, **packed_mesh(part.mesh)} for part in scene.parts],
        "bin": packed_mesh(open_bin(replay.cell.box)),
        "table": packed_mesh(table(replay)),
        "look": look(replay),
    }


def _bins(episodes: Sequence[StoredEpisode]) -> list[dict[str, Any]]:
    """Return the rows of the list; they are short, because a page may load thousands of them."""
    names = {one["name"]: i for i, one in enumerate(outcome_words())}
    return [
        {
            "key": bin_key(episode.bin_id),
            "id": episode.bin_id,
            "filled": episode.filled,
            "taken": episode.taken,
            "left": episode.left,
            "spilled": episode.spilled,
            "seconds": round(sum(sum(one["seconds"].values()) for one in episode.attempts), 2),
            "attempts": [names[one["outcome"]] for one in episode.attempts],
        }
        for episode in episodes
    ]
