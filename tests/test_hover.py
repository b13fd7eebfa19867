"""The types of public arrays that an editor shows, from the language server of Pyright."""

import inspect
import json
import re
import shutil
import subprocess
import sys
import threading
from pathlib import Path
from typing import get_args

import numpy as np
import pytest

import graycast as gc
from graycast.base import array_types

ROOT = Path(__file__).resolve().parents[1]
LONGEST_S = 120.0  # time after which the server is ended; it normally answers in seconds


def array_name(kind):
    """Return the name in array_types for a type of jaxtyping: its dtype, then its axes."""
    axes = kind.dim_str.replace("*n", "any").replace(" ", "_")
    return f"{kind.__name__.partition('[')[0]}Array_{axes}"


def arrays_in(hint):
    """Return the names of all arrays in an annotation, also in a union or a list of types."""
    assert hint is not np.ndarray and "ndarray" not in (hint if isinstance(hint, str) else "")
    if hasattr(hint, "dim_str"):
        return {array_name(hint)}
    inner = hint if isinstance(hint, list) else get_args(hint)
    return set().union(*map(arrays_in, inner))


def annotations(function):
    return list(inspect.get_annotations(inspect.unwrap(function)).values())


def values_in(hint):
    """Return the classes in an annotation that have the decorator `public_value`."""
    if inspect.isclass(hint) and hint.__module__.startswith("graycast."):
        return {hint} if hasattr(hint.__init__, "__wrapped__") else set()
    return set().union(*map(values_in, hint if isinstance(hint, list) else get_args(hint)))


def hints_of(kind):
    """Return the annotations of each public attribute and method of a class."""
    hints = {}
    for base in kind.__mro__:
        if base.__module__.startswith("graycast."):
            hints |= {name: [hint] for name, hint in inspect.get_annotations(base).items()}
            for name, member in vars(base).items():
                function = getattr(member, "fget", getattr(member, "__func__", member))
                if inspect.isfunction(function):
                    hints[name] = annotations(function)
    return {name: hint for name, hint in hints.items() if not name.startswith("_")}


def public_arrays():
    """Return the arrays of each public attribute, method and function, by its expression.

    Classes that public classes contain and that public functions return are public as well.
    """
    public = {f"gc.{name}": getattr(gc, name) for name in gc.__all__}
    functions = {name: one for name, one in public.items() if inspect.isfunction(one)}
    kinds = {name: one for name, one in public.items() if inspect.isclass(one)}
    hints = {name: annotations(one) for name, one in functions.items()}
    members = [list(hints_of(one).values()) for one in kinds.values()]
    reached = values_in([*hints.values(), *members])
    for one in reached - set(kinds.values()):
        kinds[f"{one.__module__}.{one.__qualname__}"] = one
    for name, one in kinds.items():
        hints |= {f"{name}.{field}": hint for field, hint in hints_of(one).items()}
    return {place: arrays for place, hint in hints.items() if (arrays := arrays_in(hint))}


def send(server, message):
    body = json.dumps({"jsonrpc": "2.0", **message}).encode()
    server.stdin.write(b"Content-Length: %d\r\n\r\n%s" % (len(body), body))
    server.stdin.flush()


def receive(server):
    length = 0
    while line := server.stdout.readline().strip():
        if line.lower().startswith(b"content-length:"):
            length = int(line.partition(b":")[2])
    assert length, "the language server ended"
    return json.loads(server.stdout.read(length))


def answers(server, requests):
    """Send requests and return their results in order; answer the server's own requests."""
    for number, (method, params) in enumerate(requests):
        send(server, {"id": number, "method": method, "params": params})
    results = {}
    while len(results) < len(requests):
        message = receive(server)
        if "method" not in message:
            results[message["id"]] = message["result"]
        elif message["method"] == "workspace/configuration":
            settings = [{"pythonPath": sys.executable} for _ in message["params"]["items"]]
            send(server, {"id": message["id"], "result": settings})
        elif "id" in message:
            send(server, {"id": message["id"], "result": None})
    return [results[number] for number in range(len(requests))]


def hovers(server, file):
    """Return the text that an editor shows at the end of each line of a file."""
    uri, text = file.as_uri(), file.read_text(encoding="utf-8")
    folders = [{"uri": file.parent.as_uri(), "name": "user"}]
    able = {"workspace": {"configuration": True, "workspaceFolders": True}}
    start = {"processId": None, "rootUri": None, "workspaceFolders": folders, "capabilities": able}
    answers(server, [("initialize", start)])
    send(server, {"method": "initialized", "params": {}})
    document = {"uri": uri, "languageId": "python", "version": 1, "text": text}
    send(server, {"method": "textDocument/didOpen", "params": {"textDocument": document}})
    ends = [
        {"textDocument": {"uri": uri}, "position": {"line": k, "character": len(line) - 1}}
        for k, line in enumerate(text.splitlines())
    ]
    results = answers(server, [("textDocument/hover", end) for end in ends])
    return [result["contents"]["value"] if result else "" for result in results]


def test_each_array_type_is_what_its_name_says():
    names = [name for name in vars(array_types) if "Array_" in name]
    assert len(names) > 30
    for name in names:
        kinds = get_args(getattr(array_types, name)) or (getattr(array_types, name),)
        expected = [array_name(kind) for kind in kinds]
        assert [name.replace("or16", "")] == expected[:1] and len(expected) == 1 + ("or16" in name)
        assert expected[1:] == [name.replace("UInt8or16", "UInt16")] * ("or16" in name)


@pytest.mark.slow
def test_an_editor_shows_dtype_and_axes_of_each_public_array(tmp_path):
    node = shutil.which("node")
    program = ROOT / ".venv-javascript/node_modules/pyright/langserver.index.js"
    if node is None or not program.is_file():
        pytest.skip("needs Pyright, which needs npm: make javascript")
    pytest.importorskip("torch", reason="needs torch: make extras")
    expected = public_arrays()
    assert len(expected) > 80
    assert {"gc.find_pose", "gc.DepthMap.depth_m", "graycast.rig.optics.Optics.K"} <= set(expected)
    owners = {place: place.rpartition(".")[0] for place in sorted(expected)}
    modules = {owner.rpartition(".")[0] for owner in owners.values() if owner[:3] != "gc."} - {""}
    lines = ["import graycast as gc", *(f"import {module}" for module in sorted(modules))]
    first = len(lines)
    for k, (place, owner) in enumerate(owners.items()):
        field = place.rpartition(".")[2]
        lines.append(place if owner == "gc" else f"def use_{k}(it: {owner}): it.{field}")
    user_file = tmp_path / "user.py"
    user_file.write_text("\n".join(lines) + "\n", encoding="utf-8")
    with subprocess.Popen(
        [node, program, "--stdio"], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as server:
        limit = threading.Timer(LONGEST_S, server.kill)
        limit.start()
        try:
            texts = hovers(server, user_file)[first:]
        finally:
            limit.cancel()
            server.kill()
    both = "UInt8Array_n_h_w UInt16Array_n_h_w"
    names = [
        set(re.findall(r"\w+Array_\w+", text.replace("UInt8or16Array_n_h_w", both)))
        for text in texts
    ]
    missing = {
        place: (expected[place] - has, text)
        for place, has, text in zip(owners, names, texts, strict=True)
        if not expected[place] <= has
    }
    assert not missing
