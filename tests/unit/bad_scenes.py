"""Wrong scenes, as data: each must give one clear SceneError, and exit code 2 on the command line.

`prepare(folder)` writes what the case needs and gives the scene argument and the overrides.
`fragments` are regular expressions that the message must contain: file or line, key, what is allowed.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

HEAD = "tianim: 1\nfps: 30\nduration: 1\n"
BOIDS = "systems:\n  boids:\n    kind: boids\n    count: 10\n"
SCENE = HEAD + BOIDS
FAST_WATER = """tianim: 1
duration: 1
systems:
  water:
    kind: fluid
    spacing: 0.05
    time_step: {most_substeps: 20}
    blocks: {pool: {kind: box, lower: [0, 0, 0], upper: [0.5, 0.5, 0.5], velocity: [30, 0, 0]}}
"""
STIFF_CLOTH = """tianim: 1
duration: 1
systems:
  cloth:
    kind: springs
    solver: explicit
    time_step: {most_substeps: 20}
    pieces: {cloth: {kind: sheet, segments: [40, 40]}}
"""


@dataclass(frozen=True)
class BadScene:
    """A wrong scene: `text` goes into `file` (None: no file is written), `argument` replaces its path."""

    id: str
    fragments: tuple[str, ...]
    text: str | bytes | None = SCENE
    overrides: tuple[str, ...] = ()
    file: str = "scene.yaml"
    argument: str | None = None
    setup: Callable[[Path], object] | None = None

    def prepare(self, folder: Path) -> tuple[str, list[str]]:
        """Write the case's files into `folder`; the scene argument and the overrides."""
        if self.setup is not None:
            self.setup(folder)
        path = folder / self.file
        if isinstance(self.text, bytes):
            path.write_bytes(self.text)
        elif self.text is not None:
            path.write_text(self.text, encoding="utf-8")
        return self.argument if self.argument is not None else str(path), list(self.overrides)


def bomb() -> str:
    """Nine lines that would write out to 1e9 words."""
    lines = ["a: &a [x, x, x, x, x, x, x, x, x, x]"]
    lines += [
        f"{name}: &{name} [{', '.join(10 * ['*' + before])}]"
        for before, name in zip("abcdefgh", "bcdefghi", strict=True)
    ]
    return HEAD + "\n".join(lines) + "\n"


def with_bodies(*bodies: str) -> str:
    return SCENE + "bodies:\n" + "".join(f"  {body}\n" for body in bodies)


def with_boids(*lines: str) -> str:
    return SCENE + "".join(f"    {line}\n" for line in lines)


def write(name: str, content: str | bytes) -> Callable[[Path], object]:
    data = content.encode() if isinstance(content, str) else content
    return lambda folder: (folder / name).write_bytes(data)


def points(name: str, **arrays: list[list[float]]) -> Callable[[Path], object]:
    return lambda folder: np.savez(folder / name, **{k: np.array(v) for k, v in arrays.items()})  # type: ignore[arg-type]


FILES = (
    BadScene("missing file", (r"nothing\.yaml: no such file",), None, file="nothing.yaml"),
    BadScene(
        "missing file, one like it",
        (r"sceme\.yaml: no such file; did you mean .*scene\.yaml",),
        None,
        file="sceme.yaml",
        setup=write("scene.yaml", SCENE),
    ),
    BadScene(
        "unknown name", (r"no scene 'murmuratoin'; did you mean 'murmuration'",), None, argument="murmuratoin"
    ),
    BadScene("no name", (r"no scene: give the path",), None, argument=""),
    BadScene("name with a NUL", (r"murmur", r"not a path"), None, argument="murmur\0.yaml"),
    BadScene("name far too long", (r"'x{60}': not a path of a scene",), None, argument="x" * 5000 + ".yaml"),
    BadScene(
        "folder",
        (r"scene\.yaml: a folder, not a scene file \(\.yaml, \.yml, \.toml, \.json\)",),
        None,
        setup=lambda folder: (folder / "scene.yaml").mkdir(),
    ),
    BadScene("device", (r"/dev/null: not a regular file",), None, argument="/dev/null"),
    BadScene(
        "unknown suffix",
        (r"scene\.txt: a scene file must end in \.yaml, \.yml, \.toml, \.json",),
        file="scene.txt",
    ),
    BadScene("empty file", (r"scene\.yaml: empty; .*`tianim: 1`",), ""),
    BadScene("only comments", (r"scene\.yaml: empty",), "# nothing\n\n# here\n"),
    BadScene("binary", (r"scene\.yaml: not a text file",), bytes(range(256)) * 8),
    BadScene("control characters", (r"scene\.yaml: not a text file",), "tianim: \x01\n"),
    BadScene("huge file", (r"scene\.yaml: 11 MB; .*10 MB",), b"#" * 11_000_000),
    BadScene("list at the top", (r"scene\.yaml: a scene must be a mapping, not a list",), "- 1\n- 2\n"),
    BadScene("text at the top", (r"scene\.yaml: a scene must be a mapping, not text",), "murmuration\n"),
)

SYNTAX = (
    BadScene("YAML bracket left open", (r"scene\.yaml:\d+: not valid YAML",), SCENE + "seed: [1,\n"),
    BadScene("YAML two colons", (r"scene\.yaml:4: not valid YAML: mapping values",), HEAD + "title: a: b\n"),
    BadScene("YAML tab", (r"scene\.yaml:4: not valid YAML: .*\\t",), HEAD + "\tsystems: 1\n"),
    BadScene(
        "YAML two documents", (r"scene\.yaml:\d+: not valid YAML: .*another document",), SCENE + "---\na: 1\n"
    ),
    BadScene("YAML undefined alias", (r"scene\.yaml:4: .*undefined alias 'start'",), HEAD + "view: *start\n"),
    BadScene("YAML bomb", (r"scene\.yaml:\d+: more than 100000 values once its aliases",), bomb()),
    BadScene("YAML alias in itself", (r"scene\.yaml:4: nested deeper than 64",), HEAD + "view: &a [*a]\n"),
    BadScene(
        "YAML too deep", (r"scene\.yaml:4: nested deeper than 64",), HEAD + "view: " + "[" * 3000 + "]" * 3000
    ),
    BadScene(
        "YAML tag that would run code",
        (r"scene\.yaml:4: tags are not allowed: !!python/object/apply:os\.system",),
        HEAD + "title: !!python/object/apply:os.system ['touch tianim_was_here']\n" + BOIDS,
    ),
    BadScene(
        "YAML harmless tag",
        (r"scene\.yaml:4: tags are not allowed: !!str",),
        HEAD + "title: !!str 3\n" + BOIDS,
    ),
    BadScene("YAML key not text", (r"scene\.yaml:4: a key must be text, not 7",), HEAD + "7: 3\n" + BOIDS),
    BadScene("YAML key a list", (r"scene\.yaml:4: a key must be text",), HEAD + "? [1, 2]\n: 3\n" + BOIDS),
    BadScene("YAML key twice", (r"scene\.yaml:4: key 'fps' stands twice",), HEAD + "fps: 25\n" + BOIDS),
    BadScene(
        "two systems with one name",
        (r"scene\.yaml:8: two systems with one name: 'boids'",),
        SCENE + "  boids: {kind: boids, count: 20}\n",
    ),
    BadScene(
        "two bodies with one name",
        (r"scene\.yaml:\d+: two bodies with one name: 'rock'",),
        with_bodies("rock: {kind: sphere}", "rock: {kind: box}"),
    ),
    BadScene(
        "TOML key twice",
        (r"scene\.toml: not valid TOML: Cannot overwrite a value",),
        "tianim = 1\ntianim = 1\n",
        file="scene.toml",
    ),
    BadScene(
        "TOML without a value",
        (r"scene\.toml: not valid TOML: .*line 2",),
        "tianim = 1\nfps = \n",
        file="scene.toml",
    ),
    BadScene(
        "TOML too deep",
        (r"scene\.toml: not valid TOML|scene\.toml: nested deeper",),
        "a = " + "[" * 3000,
        file="scene.toml",
    ),
    BadScene(
        "TOML date",
        (r"scene\.toml: seed = datetime.*: must be a whole number",),
        'tianim = 1\nseed = 1979-05-27\n[systems.boids]\nkind = "boids"\ncount = 10\n',
        file="scene.toml",
    ),
    BadScene(
        "JSON key twice",
        (r"scene\.json: key 'fps' stands twice",),
        '{"tianim": 1, "fps": 1, "fps": 2}',
        file="scene.json",
    ),
    BadScene(
        "JSON NaN",
        (r"scene\.json: .*NaN is not a number that JSON has",),
        '{"tianim": 1, "fps": NaN}',
        file="scene.json",
    ),
    BadScene(
        "JSON cut off", (r"scene\.json:2: not valid JSON",), '{"tianim": 1,\n"fps": ', file="scene.json"
    ),
    BadScene(
        "JSON too deep",
        (r"scene\.json: (not valid JSON: )?nested",),
        "[" * 3000 + "]" * 3000,
        file="scene.json",
    ),
)

KEYS = (
    BadScene("no version", (r"scene\.yaml:1: missing key 'tianim'",), "fps: 30\n" + BOIDS),
    BadScene(
        "another version", (r"scene\.yaml:1: tianim = 2: must be 1",), SCENE.replace("tianim: 1", "tianim: 2")
    ),
    BadScene("no systems", (r"missing key 'systems'", "boids"), HEAD),
    BadScene(
        "empty systems",
        (r"scene\.yaml:4: systems = \{\}: must hold at least 1 entry", "boids"),
        HEAD + "systems: {}\n",
    ),
    BadScene(
        "systems left blank", (r"scene\.yaml:4: systems = null: must be a mapping",), HEAD + "systems:\n"
    ),
    BadScene(
        "systems as a list",
        (r"scene\.yaml:4: systems = \[.*\]: must be a mapping",),
        HEAD + "systems: [{kind: boids}]\n",
    ),
    BadScene(
        "system without a kind",
        (r"scene\.yaml:5: systems\.boids: missing key 'kind' \(allowed: .*boids",),
        HEAD + "systems:\n  boids: {count: 10}\n",
    ),
    BadScene(
        "unknown kind of system",
        (r"scene\.yaml:6: systems\.boids\.kind = 'boidz'", "did you mean 'boids'", "allowed: "),
        SCENE.replace("kind: boids", "kind: boidz"),
    ),
    BadScene(
        "system name that ends in a digit",
        (r"scene\.yaml:5: systems\.boids2", "does not end in a digit"),
        SCENE.replace("  boids:", "  boids2:"),
    ),
    BadScene(
        "system name with a blank",
        (r"scene\.yaml:5: systems\.big boids", "letters, digits and _"),
        SCENE.replace("  boids:", "  big boids:"),
    ),
    BadScene(
        "system name that is too long",
        (r"scene\.yaml:5: systems\.b{65}: a name has at most 64 characters$",),
        SCENE.replace("  boids:", f"  {'b' * 65}:"),
    ),
    BadScene(
        "too many bodies",
        (r"scene\.yaml:8: bodies: must hold at most 1000 entries, not 1001$",),
        with_bodies(*(f"b{n}x: {{kind: sphere}}" for n in range(1001))),
    ),
    BadScene(
        "version as text",
        (r"scene\.yaml:1: tianim = '1': must be 1$",),
        SCENE.replace("tianim: 1", "tianim: '1'"),
    ),
    BadScene(
        "title that is too long",
        (r"scene\.yaml:8: title = 'x+\.\.\.x+': must have at most 200 characters$",),
        SCENE + f"title: {'x' * 201}\n",
    ),
    BadScene(
        "time step far below a frame",
        (r"scene\.yaml:5: systems\.boids: a frame would need more than 1,000,000 substeps of 1e-12 s$",),
        with_boids("time_step: 1e-12"),
    ),
    BadScene(
        "more substeps than the fluid allows",
        (
            r"scene\.yaml:4: systems\.water: a frame would need 40 substeps, of 0\.000833 s \(flow\)",
            "most_substeps, 20",
        ),
        FAST_WATER,
    ),
    BadScene(
        "more substeps than springs may have",
        (
            r"systems\.cloth: a frame would need [\d,]+ substeps, of \S+ s \(the explicit solver\)",
            r"more than time_step\.most_substeps, 20: softer springs.*solver: projective",
        ),
        STIFF_CLOTH,
    ),
    BadScene(
        "springs that the solver cannot step",
        (r"systems\.cloth: solver: strands is for ropes and strands alone",),
        STIFF_CLOTH.replace("explicit", "strands"),
    ),
    BadScene(
        "cells of a sheet that are too oblong",
        (r"systems\.cloth: pieces\.cloth: cells of 0\.333 x 0\.025 m are too oblong",),
        STIFF_CLOTH.replace("explicit", "projective").replace("[40, 40]", "[3, 40]"),
    ),
    BadScene(
        "system and body of one name",
        (r"systems\.boids: a system and a body have one name: 'boids'",),
        with_bodies("boids: {kind: sphere}"),
    ),
    BadScene(
        "misspelt top key",
        (r"scene\.yaml:8: unknown key 'duratoin'; did you mean 'duration'\?",),
        SCENE + "duratoin: 3\n",
    ),
    BadScene(
        "misspelt key of a system",
        (r"scene\.yaml:8: systems\.boids: unknown key 'limitz'", "did you mean 'limits'"),
        with_boids("limitz: {max_speed: 3}"),
    ),
    BadScene(
        "misspelt key deep down",
        (r"scene\.yaml:8: systems\.boids\.limits: unknown key 'max_sped'", "'max_speed'"),
        with_boids("limits: {max_sped: 3}"),
    ),
    BadScene(
        "key of another kind",
        (r"bounds: unknown key 'lower' for kind 'open' \(allowed: kind\)",),
        SCENE + "bounds: {kind: open, lower: [0, 0, 0]}\n",
    ),
    BadScene(
        "missing key",
        (r"scene\.yaml:8: bounds: missing key 'upper': a list of 3 numbers",),
        SCENE + "bounds: {kind: periodic, lower: [0, 0, 0]}\n",
    ),
    BadScene(
        "many problems",
        (r"duration = -1", r"and 3 more problems"),
        SCENE.replace("duration: 1", "duration: -1") + "seed: -1\ncheckpoint: {every: 0}\nfsp: 3\ntitel: x\n",
    ),
)

VALUES = (
    BadScene(
        "zero frames a second",
        (r"scene\.yaml:2: fps = 0: must be greater than 0",),
        SCENE.replace("fps: 30", "fps: 0"),
    ),
    BadScene(
        "frames a second beyond",
        (r"fps = 100000: must be less than or equal to 1000",),
        SCENE.replace("fps: 30", "fps: 1e5"),
    ),
    BadScene(
        "zero frames",
        (r"scene\.yaml:3: duration = -1: must be greater than or equal to 0",),
        SCENE.replace("duration: 1", "duration: -1"),
    ),
    BadScene(
        "too many frames",
        (r"scene\.yaml:3: duration = 100000000: .*3,000,000,001 frames; at most 1,000,000",),
        SCENE.replace("duration: 1", "duration: 1e8"),
    ),
    BadScene(
        "duration as text",
        (r"duration = '10 s': must be a number",),
        SCENE.replace("duration: 1", "duration: 10 s"),
    ),
    BadScene(
        "duration NaN",
        (r"duration = nan: must be a finite number",),
        SCENE.replace("duration: 1", "duration: .nan"),
    ),
    BadScene("seed NaN", (r"seed = nan: must be a",), SCENE + "seed: .nan\n"),
    BadScene(
        "duration overflows",
        (r"duration = inf: must be a finite number",),
        SCENE.replace("duration: 1", "duration: 1e400"),
    ),
    BadScene("no as a number", (r"seed = 'no': must be a whole number",), SCENE + "seed: no\n"),
    BadScene(
        "on as true or false",
        (r"view\.shadows = 'on': must be true or false",),
        SCENE + "view: {shadows: on}\n",
    ),
    BadScene(
        "10^12 particles",
        (r"scene\.yaml:7: systems\.boids\.count = 1000000000000: must be less than or equal to 100000000",),
        SCENE.replace("count: 10", "count: 1e12"),
    ),
    BadScene(
        "negative count",
        (r"scene\.yaml:7: systems\.boids\.count = -5: must be greater than or equal to 0",),
        SCENE.replace("count: 10", "count: -5"),
    ),
    BadScene(
        "half a particle",
        (r"systems\.boids\.count = 1\.5: must be a whole number",),
        SCENE.replace("count: 10", "count: 1.5"),
    ),
    BadScene(
        "count of 5000 digits",
        (r"systems\.boids\.count = .*: must be a whole number",),
        SCENE.replace("count: 10", "count: " + "9" * 5000),
    ),
    BadScene(
        "checkpoint every 0",
        (r"checkpoint\.every = 0: must be greater than or equal to 1",),
        SCENE + "checkpoint: {every: 0}\n",
    ),
    BadScene(
        "seed beyond", (r"seed = 4294967296: must be less than 4294967296",), SCENE + "seed: 4294967296\n"
    ),
    BadScene(
        "bounds inside out",
        (r"bounds: lower must be less than upper .* in y, 3 is not below 2",),
        SCENE + "bounds: {kind: contained, lower: [0, 3, 0], upper: [1, 2, 1]}\n",
    ),
    BadScene(
        "flat bounds",
        (r"bounds: lower must be less than upper",),
        SCENE + "bounds: {kind: periodic, lower: [0, 0, 0], upper: [1, 1, 0]}\n",
    ),
    BadScene(
        "corner of two numbers",
        (r"bounds\.lower = \[0, 0\]: must be a list of 3 numbers",),
        SCENE + "bounds: {kind: periodic, lower: [0, 0], upper: [1, 1, 1]}\n",
    ),
    BadScene(
        "unknown kind of bounds",
        (r"bounds\.kind = 'torus': unknown kind \(allowed: contained, open, periodic\)",),
        SCENE + "bounds: {kind: torus}\n",
    ),
    BadScene("title of 10,000 letters", (r"title = 'xxx.*\.\.\.",), SCENE + f"title: {'x' * 10_000}\n"),
    BadScene(
        "unknown format",
        (r"output\.formats = \['vtj'\]: .*'vtj'", "vtu"),
        SCENE + "output: {formats: [vtj]}\n",
    ),
    BadScene(
        "unknown word",
        (r"view\.renderer = 'splatt': must be one of 'auto', 'splat', 'open3d'", "did you mean 'splat'"),
        SCENE + "view: {renderer: splatt}\n",
    ),
    BadScene("odd width", (r"view\.width = 641: must be a multiple of 2",), SCENE + "view: {width: 641}\n"),
    BadScene(
        "least above most",
        (r"systems\.boids\.limits: min_speed 5 must not exceed max_speed 2",),
        with_boids("limits: {min_speed: 5, max_speed: 2}"),
    ),
    BadScene(
        "unknown behaviour",
        (r"scene\.yaml:8: systems\.boids\.behaviours\.0\.kind = 'hide': unknown kind \(allowed: .*wander",),
        with_boids("behaviours: [{kind: hide}]"),
    ),
    BadScene(
        "target that is not there",
        (r"systems\.boids: .*target: no body 'shark'",),
        with_boids("behaviours: [{kind: flee, target: {kind: body, name: shark}}]"),
    ),
    BadScene(
        "system that needs other bounds",
        (r"systems\.swarm: vicsek needs bounds of kind periodic",),
        HEAD + "systems:\n  swarm: {kind: vicsek, count: 10}\n",
    ),
)

KEYFRAMES = (
    BadScene(
        "keyframes out of order",
        (r"scene\.yaml:8: systems\.boids\.speed|limits\.max_speed", "times must rise: 1 comes after 2"),
        with_boids("limits: {max_speed: {keys: [[0, 1], [2, 3], [1, 2]]}}"),
    ),
    BadScene(
        "two keyframes at one time",
        (r"systems\.boids\.limits\.max_speed: keyframe times must rise: 0 comes after 0",),
        with_boids("limits: {max_speed: {keys: [[0, 1], [0, 3]]}}"),
    ),
    BadScene(
        "no keyframes",
        (r"limits\.max_speed\.keys = \[\]: must hold at least 1 entry",),
        with_boids("limits: {max_speed: {keys: []}}"),
    ),
    BadScene(
        "keyframe out of range",
        (r"limits\.max_speed\.keys\.1\.1 = -3: must be greater than 0",),
        with_boids("limits: {max_speed: {keys: [[0, 1], [1, -3]]}}"),
    ),
    BadScene(
        "keyframe without a time",
        (r"limits\.max_speed\.keys\.0 = \[1\]: must be a list of 2",),
        with_boids("limits: {max_speed: {keys: [[1]]}}"),
    ),
    BadScene(
        "unknown interpolation",
        (r"interpolation = 'cubik': must be one of 'linear', 'cubic'", "did you mean 'cubic'"),
        with_boids("limits: {max_speed: {keys: [[0, 1]], interpolation: cubik}}"),
    ),
    BadScene(
        "cubic that overshoots",
        (r"limits\.max_speed: the cubic curve reaches -", "pchip"),
        with_boids(
            "limits: {max_speed: {keys: [[0, 0.1], [1, 0.1], [2, 5], [3, 0.1]], interpolation: cubic}}"
        ),
    ),
    BadScene(
        "count keyframed",
        (r"scene\.yaml:7: systems\.boids\.count: may not be keyframed; must be a whole number",),
        SCENE.replace("count: 10", "count: {keys: [[0, 1], [1, 5]]}"),
    ),
    BadScene(
        "bounds keyframed", (r"bounds: may not be keyframed",), SCENE + "bounds: {keys: [[0, 1], [1, 5]]}\n"
    ),
)

BODIES = (
    BadScene(
        "negative radius",
        (r"scene\.yaml:9: bodies\.rock\.radius = -1: must be greater than 0",),
        with_bodies("rock: {kind: sphere, radius: -1}"),
    ),
    BadScene(
        "overlapping spheres",
        (r"scene\.yaml:10: bodies\.other: overlaps bodies\.one by 0\.5 m",),
        with_bodies("one: {kind: sphere}", "other: {kind: sphere, position: [1.5, 0, 0]}"),
    ),
    BadScene(
        "box in the floor",
        (r"bodies\.block: overlaps bodies\.floor by 0\.25 m",),
        with_bodies("floor: {kind: plane}", "block: {kind: box, position: [0, 0.25, 0]}"),
    ),
    BadScene(
        "capsule in a keyframed box",
        (r"bodies\.rod: overlaps bodies\.block",),
        with_bodies(
            "block: {kind: box, position: {keys: [[0, [0, 0, 0]], [1, [9, 0, 0]]]}}", "rod: {kind: capsule}"
        ),
    ),
    BadScene(
        "plane without a direction",
        (r"bodies\.floor.*normal.*: must not be the zero vector",),
        with_bodies("floor: {kind: plane, normal: [0, 0, 0]}"),
    ),
    BadScene(
        "mesh file missing",
        (r"bodies\.rock\.file = 'rock\.obj': no such file: .*rock\.obj",),
        with_bodies("rock: {kind: mesh, file: rock.obj}"),
    ),
    BadScene(
        "mesh that is not one",
        (r"bodies\.rock: .*rock\.obj",),
        with_bodies("rock: {kind: mesh, file: rock.obj}"),
        setup=write("rock.obj", "this is no mesh\n"),
    ),
    BadScene(
        "mesh with a hole",
        (r"bodies\.rock: .*rock\.obj is not watertight",),
        with_bodies("rock: {kind: mesh, file: rock.obj}"),
        setup=write("rock.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"),
    ),
    BadScene(
        "mesh of no format",
        (r"bodies\.rock: .*rock\.docx", r"\.obj"),
        with_bodies("rock: {kind: mesh, file: rock.docx}"),
        setup=write("rock.docx", b"PK"),
    ),
    BadScene(
        "mesh sequence of nothing",
        (r"bodies\.fish\.files = 'swim': .*two or more meshes",),
        with_bodies("fish: {kind: mesh_sequence, files: swim}"),
        setup=lambda folder: (folder / "swim").mkdir(),
    ),
    BadScene(
        "start file missing",
        (r"systems\.boids\.start\.path = 'start\.npz': no such file",),
        with_boids("start: {kind: file, path: start.npz}"),
    ),
    BadScene(
        "start file broken",
        (r"systems\.boids\.start: .*start\.npz",),
        with_boids("start: {kind: file, path: start.npz}"),
        setup=write("start.npz", b"not an archive"),
    ),
    BadScene(
        "start file without positions",
        (r"systems\.boids\.start: .*start\.npz: holds no array called position",),
        with_boids("start: {kind: file, path: start.npz}"),
        setup=points("start.npz", velocity=[[0.0, 0.0, 1.0]]),
    ),
    BadScene(
        "start file of another length",
        (r"systems\.boids: count 10: must be 1,",),
        with_boids("start: {kind: file, path: start.npz}"),
        setup=points("start.npz", position=[[0.0, 0.0, 1.0]]),
    ),
)

OVERRIDES = (
    BadScene(
        "override without a value",
        (r"override 'boids\.count': must be key=value",),
        overrides=("boids.count",),
    ),
    BadScene("override without a key", (r"override '=3': must be key=value",), overrides=("=3",)),
    BadScene(
        "override of nothing known",
        (r"override boidz\.count=3: unknown key 'boidz'; did you mean 'boids'\?",),
        overrides=("boidz.count=3",),
    ),
    BadScene(
        "override misspelt",
        (r"override boids\.cuont=3: unknown key 'systems\.boids\.cuont'.* did you mean 'count'\?",),
        overrides=("boids.cuont=3",),
    ),
    BadScene(
        "override misspelt deep down",
        (r"override view\.camera\.orbitt=3: unknown key 'view\.camera\.orbitt'; did you mean 'orbit'\?",),
        overrides=("view.camera.orbitt=3",),
    ),
    BadScene(
        "override out of range",
        (r"override boids\.count=-5: must be greater than or equal to 0",),
        overrides=("boids.count=-5",),
    ),
    BadScene(
        "override of another type", (r"override seed=many: must be a whole number",), overrides=("seed=many",)
    ),
    BadScene("override with open bracket", (r"override seed=\[1: .*not valid YAML",), overrides=("seed=[1",)),
    BadScene(
        "override with a tag",
        (r"override title=!!python/name:os\.system.*: tags are not allowed",),
        overrides=("title=!!python/name:os.system x",),
    ),
    BadScene(
        "override past the end",
        (r"override boids\.behaviours\.3\.weight=2: '3' must be a number from 0 to 0",),
        with_boids("behaviours: [{kind: wander}]"),
        overrides=("boids.behaviours.3.weight=2",),
    ),
    BadScene(
        "override into a number",
        (r"override seed\.keys=3: seed may not be keyframed",),
        overrides=("seed.keys=3",),
    ),
    BadScene(
        "override of a system that is not there",
        (r"override systems\.boidz\.count=3: no systems\.boidz; did you mean 'boids'\?",),
        overrides=("systems.boidz.count=3",),
    ),
    BadScene(
        "override before a kind",
        (r"override bounds\.lower=\[0,0,0\]: unknown key 'bounds\.lower' for kind 'open'",),
        overrides=("bounds.lower=[0,0,0]",),
    ),
    BadScene(
        "override with empty words",
        (r"override boids\.\.count=3: a key is made of words",),
        overrides=("boids..count=3",),
    ),
)

BAD_SCENES = (*FILES, *SYNTAX, *KEYS, *VALUES, *KEYFRAMES, *BODIES, *OVERRIDES)
