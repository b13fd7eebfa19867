"""The command that shows a cell alive: live."""

import argparse

from .arguments import add_command, add_config, add_device, positive, seed

# Heavy modules are imported by the command that needs them, so that --help answers at once.

PORT = 8337
LIVE = """\
Show a cell in the browser, where every setting can be changed. A change of exposure, noise,
thresholds or filters takes effect at once, because the rendered light is kept. A change of the
light or the rig renders the scene again, first with few samples. A change of the parts also
simulates their fall again. The button Save writes a YAML file from which graycast preview makes
the same picture. The page can be opened only on this machine. Ctrl-C ends the command."""


def add_commands(commands) -> None:
    live = add_command(
        commands, "live", _live, "Show a cell in the browser, and change its settings there."
    )
    live.description = LIVE
    live.set_defaults(when_stopped="the files that the page saved are kept")
    add_config(live)
    live.add_argument(
        "--port",
        type=positive,
        default=PORT,
        help=f"The TCP port of the page on this machine (default: {PORT}).",
    )
    live.add_argument(
        "--scene",
        type=seed,
        default=0,
        help="The number of the scene to show, counted from 0 (default: 0).",
    )
    live.add_argument("--open", action="store_true", help="Open the page in a browser.")
    add_device(live)


def _live(options: argparse.Namespace) -> int:
    import webbrowser

    from ..show.live import Server

    server = Server(
        options.config, port=options.port, scene_id=options.scene, device=options.device
    )
    print(f"{options.config} is shown at {server.url} (press Ctrl-C to end)", flush=True)
    if options.open:
        webbrowser.open(server.url)
    try:
        server.run()
    finally:
        server.release()
    return 0
