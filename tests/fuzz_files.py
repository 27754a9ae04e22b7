"""Files that are nearly right: scenes, studies, tables and meshes, with damage."""

import copy
import re
from pathlib import Path

import numpy as np
from fuzz_inputs import INF, LONG, NAN
from fuzz_judge import check_run
from hypothesis import strategies as st

from sweepopt.fem import read_mesh, read_scene
from sweepopt.io import find_scene, find_study, read_toml

DATA = Path(__file__).parent / "data"
MESHES = ["tube_2.2.msh", "tube_2.2_binary.msh", "tube_4.1.msh", "tube_4.1_binary.msh"]
ROWS = ["0,0,0", "60,3e3,1", "90.5,-1e3,0", "120,0,0"]
CSV = "\n".join(["# a comment, with a comma", "t,f2,command", *ROWS, ""])
FULL = """
[effects.body_force]
f0 = { core = 2.0, sleeve = 1.0 }
history = { waveform = "sine", amplitude = 1.0, period = 4.0 }
[[effects.traction]]
on = ["pulled"]
f2 = { along = "radius", at = [0.0, 3.0], values = [1.0, 2.0] }
history = { table = { t = [0.0, 60.0, 120.0], values = [0.0, 1.0, 0.0] } }
"""


def write_seeds(folder):
    """The files that are damaged later: a small tube, its loads, its meshes."""
    for path in (DATA / "gmsh").glob("*.msh"):
        (folder / path.name).write_bytes(path.read_bytes())
    (folder / "tube.msh").write_bytes((DATA / "gmsh" / "tube_2.2.msh").read_bytes())
    (folder / "tube_loads.csv").write_text(CSV)
    (folder / "folder.msh").mkdir()
    tube = find_scene("tube").read_text()
    (folder / "tube.toml").write_text(tube)
    full = tube.replace("[effects.traction]", "[[effects.traction]]").replace('"P2"', '"P1"')
    (folder / "full.toml").write_text(full + FULL)
    for name in ("accuracy", "hard"):
        (folder / f"{name}.toml").write_text(find_study(name).read_text())


# ---- damage ---------------------------------------------------------------------------------

TOKENS = b"nan inf -1 0 1e400 \x00 \xff \" ' [ ] { } true 1979-05-27 , \xef\xbb\xbf = .".split(b" ")
TOKENS += b'# 1,5 1e300 -1e-320 "\\u0000" \xe2\x80\xa8 99999999999 $EndElements \x85 ;'.split(b" ")
TOKENS += [b"-9223372036854775808", b"", b" ", b"\n", b"\r", b"\t"]
TOKENS += [b"9" * 5000, b"9" * 30, b"[" * 3000, b"a" * 5000]


# the parts a file is made of, what is done to one, two shares of their number, what comes in
PARTS = [rb"[^\n]*\n?", rb"[^\s,=]+|[\s,=]", rb"."]  # lines, words, bytes
HOW = ["cut", "flip", "insert", "drop", "twice", "swap", "replace", "replace"]
SHARE = st.floats(0, 1, width=32)
DAMAGES = st.lists(
    st.tuples(*map(st.sampled_from, (PARTS, HOW)), SHARE, SHARE, st.sampled_from(TOKENS)),
    max_size=2,
)


def damage(content, pattern, how, share, more, new):
    parts = re.findall(pattern, content, re.DOTALL) or [b""]
    k, other = (int(x * (len(parts) - 1)) for x in (share, more))
    part = parts[k]
    match how:
        case "cut":
            del parts[k:]
        case "flip":
            parts[k] = bytes(byte ^ (1 << int(7 * more)) for byte in part)
        case "insert" | "twice":
            parts.insert(k, new if how == "insert" else part)
        case "drop" | "replace":
            parts[k] = new if how == "replace" else b""
        case "swap":
            parts[k], parts[other] = parts[other], part
    return b"".join(parts)


def damaged(folder, name, damages):
    """The file after all of it, beside its neighbours."""
    content = (folder / name).read_bytes()
    for one in damages:
        content = damage(content, *one)
    path = folder / f"damaged{Path(name).suffix}"
    path.write_bytes(content)
    return path


# ---- scenes and studies ---------------------------------------------------------------------

DEEP = 1.0
for _ in range(300):
    DEEP = [DEEP]
VALUES = [NAN, INF, -INF, 1e300, -1e300, 5e-324, 10**400, 0, -1, 1, 2.5, True, None, ""]
VALUES += ["x", "contact", "core", "\0", "a" * 5000, "../tube.msh", "folder.msh", "absent.csv", []]
VALUES += [[1.0], {}, {"core": 1.0}, {"core": 1.0, "sleeve": "x"}, {"a": {"b": {"c": 1}}}, DEEP]
VALUES += [{"along": "x", "at": [0, 1], "values": [1, 2]}, {"waveform": "sine"}, {"csv": "\0"}]
VALUES += [{"csv": "tube_loads.csv", "column": "f2"}, ["contact", "pulled"], b"x", object(), 1j]
VALUES += [{"table": {"t": [0, 120], "values": [10**400, 1]}}, *MESHES, "exact"]


WHAT = st.sampled_from(["set", "set", "set", "set", "drop", "rename", "wrap"])
VALUE = st.one_of(*map(st.just, VALUES), LONG)
CHANGES = st.lists(st.tuples(st.integers(0, 60), WHAT, VALUE), max_size=2)


def change(data, at, how, value):
    """A key of a nest of tables gets another value, is dropped or renamed."""
    places = list(_places(data))
    if not places:
        return
    table, key = places[at % len(places)]
    if how == "drop":
        del table[key]
    elif how == "rename" and isinstance(table, dict):
        table[f"{key}x"] = table.pop(key)
    else:
        table[key] = [table[key]] if how == "wrap" else copy.deepcopy(value)


def _places(data):
    keys = data if isinstance(data, dict) else range(len(data))
    for key in list(keys):
        yield data, key
        if isinstance(data[key], (dict, list)):
            yield from _places(data[key])


SCENES = st.sampled_from(["tube.toml", "full.toml"])


def ask_scene(folder, name, file):
    """A scene that is read is simulated, for three steps."""
    damages, changes = file
    if changes:
        data = copy.deepcopy(read_toml(folder / name))
        for one in changes:
            change(data, *one)
        scene = read_scene(data, folder=folder)
    else:
        scene = read_scene(damaged(folder, name, damages))
    check_run(scene.solve(steps=3))


# ---- tables, meshes ---------------------------------------------------------------------------


def ask_mesh(folder, name, damages):
    """A mesh that is read has finite nodes and triangles that name them."""
    mesh = read_mesh(damaged(folder, name, damages))
    assert np.isfinite(mesh.doflocs).all()
    assert 0 <= mesh.t.min() <= mesh.t.max() < mesh.p.shape[1]
    for members in (mesh.boundaries or {}).values():
        assert members.max(initial=0) < mesh.facets.shape[1]
    for members in (mesh.subdomains or {}).values():
        assert members.max(initial=0) < mesh.nelements
