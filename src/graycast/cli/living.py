"""The command that shows a cell alive: live."""

import argparse

from .arguments import add_command, add_config, add_device, positive, seed

# Heavy modules are imported by the command that needs them, so that --help answers at once.

PORT = 8337
LIVE = """\
Show a cell in the browser, and let every setting be turned while one looks. Exposure, noise,
thresholds and filters answer at once from the light that is kept; another light or rig is rendered,
roughly first; other parts are dropped. Save writes a YAML file of which graycast preview makes the
same picture. The page is on this machine alone. Ctrl-C ends the command."""


def add_commands(commands) -> None:
    live = add_command(
        commands, "live", _live, "Show a cell in the browser, and turn its settings there."
    )
    live.description = LIVE
    live.set_defaults(when_stopped="what was saved from the page is kept")
    add_config(live)
    live.add_argument(
        "--port",
        type=positive,
        default=PORT,
        help=f"The port of this machine that the page is on (default: {PORT}).",
    )
    live.add_argument(
        "--scene", type=seed, default=0, help="The number of the scene to show (default: 0)."
    )
    live.add_argument("--open", action="store_true", help="Also open the page in a browser.")
    add_device(live)


def _live(options: argparse.Namespace) -> int:
    import webbrowser

    from ..live import Server

    server = Server(
        options.config, port=options.port, scene_id=options.scene, device=options.device
    )
    print(f"{options.config} is alive at {server.url} (Ctrl-C ends it)", flush=True)
    if options.open:
        webbrowser.open(server.url)
    try:
        server.run()
    finally:
        server.release()
    return 0
