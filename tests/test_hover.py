"""Types of public arrays as an editor shows them, by the language server of Pyright."""

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
LONGEST_S = 120.0  # The server answers in a few seconds, or else is ended after this time.


def array_name(kind):
    """Return the name that array_types gives to a type of jaxtyping: its dtype, then its axes."""
    axes = kind.dim_str.replace("*n", "any").replace(" ", "_")
    return f"{kind.__name__.partition('[')[0]}Array_{axes}"


def arrays_in(hint):
    """Return the names of all arrays in an annotation, such as in a union or a list of types."""
    assert hint is not np.ndarray and "ndarray" not in (hint if isinstance(hint, str) else "")
    if hasattr(hint, "dim_str"):
        return {array_name(hint)}
    inner = hint if isinstance(hint, list) else get_args(hint)
    return set().union(*map(arrays_in, inner))


def annotations(function):
    return inspect.get_annotations(inspect.unwrap(function)).values()


def public_arrays():
    """Return the arrays that each public attribute, method and function has, by expression."""
    places = {}
    for name in gc.__all__:
        value = getattr(gc, name)
        if inspect.isfunction(value):
            places[f"gc.{name}"] = arrays_in(list(annotations(value)))
        for kind in value.__mro__ if inspect.isclass(value) else ():
            if not kind.__module__.startswith("graycast."):
                continue
            for field, hint in inspect.get_annotations(kind).items():
                places[f"gc.{name}.{field}"] = arrays_in(hint)
            for field, member in vars(kind).items():
                function = getattr(member, "fget", getattr(member, "__func__", member))
                if inspect.isfunction(function):
                    places[f"gc.{name}.{field}"] = arrays_in(list(annotations(function)))
    return {place: arrays for place, arrays in places.items() if arrays and "._" not in place}


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
    """Send requests, and return their results in order; meanwhile answer the server's questions."""
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
    expected = public_arrays()
    assert len(expected) > 60 and {"gc.DepthMap.depth_m", "gc.find_pose"} <= set(expected)
    lines = ["import graycast as gc"]
    for k, place in enumerate(expected):
        owner, _, field = place.rpartition(".")
        lines.append(place if owner == "gc" else f"def use_{k}(it: {owner}): it.{field}")
    user_file = tmp_path / "user.py"
    user_file.write_text("\n".join(lines) + "\n", encoding="utf-8")
    with subprocess.Popen(
        [node, program, "--stdio"], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as server:
        limit = threading.Timer(LONGEST_S, server.kill)
        limit.start()
        try:
            texts = hovers(server, user_file)[1:]
        finally:
            limit.cancel()
            server.kill()
    both = "UInt8Array_n_h_w UInt16Array_n_h_w"
    shown = [
        set(re.findall(r"\w+Array_\w+", text.replace("UInt8or16Array_n_h_w", both)))
        for text in texts
    ]
    missing = {
        place: (arrays - has, text)
        for (place, arrays), has, text in zip(expected.items(), shown, texts, strict=True)
        if not arrays <= has
    }
    assert not missing
