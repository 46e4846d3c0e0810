"""Imports go one way: examples, tests -> python/trackrs -> _trackrs -> rust/trackrs-py -> rust/trackrs.

Inside the core they go from high to low. The checks read source text, so they hold before anything is built. Each has a
test that shows it failing.
"""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
CORE = ROOT / "rust" / "trackrs"
PACKAGE = ROOT / "python" / "trackrs"

# The core, lowest first. A module may use itself and the lines above its own; neighbours on one line are strangers.
LAYERS = [
    {"error"},
    {"event", "state", "interrupt", "threads"},
    {"linalg"},
    {"lanes"},
    {"stats", "geodesy"},
    {"partition"},
    {"gaussian"},
    {"scan", "track"},
    {"model"},
    {"filter"},
    {"gating"},
    {"association"},
    {"rfs", "metric"},
    {"tracker"},
    {"sim"},
]
RANK = {module: rank for rank, layer in enumerate(LAYERS) for module in layer}
ONLY_FOR = {"lanes": {"lanes", "filter", "gating", "partition", "association"}}

# --- reading Rust ----------------------------------------------------------------------------------------------------

# Comments, raw strings, strings and characters, in the order in which they are tried. Lifetimes stay.
NOT_CODE = re.compile(
    r"""//[^\n]* | /\*.*?\*/ | \bb?r(?P<hash>\#*)".*?"(?P=hash) | "(?:\\.|[^"\\])*" | '(?:\\[^']+|[^'\\])'""",
    re.DOTALL | re.VERBOSE,
)
TESTS = re.compile(r"#\[cfg\(test\)\]\s*(?:#\[[^\]]*\]\s*)*mod\s+\w+\s*\{")
PATH_START = re.compile(r"\b(?:crate|super|self)\s*::")
TOKEN = re.compile(r"\s*(::|[{},*]|\w+)")


def code_of(text: str) -> str:
    """The text without comments, literals and test modules."""
    text = NOT_CODE.sub(" ", text)
    while found := TESTS.search(text):
        depth, end = 1, found.end()
        while depth:
            depth += {"{": 1, "}": -1}.get(text[end], 0)
            end += 1
        text = text[: found.start()] + text[end:]
    return text


def tree(text: str, at: int, prefix: tuple[str, ...]) -> tuple[list[tuple[str, ...]], int]:
    """The paths of the use tree (or plain path) at this position, and where it ends."""
    while token := TOKEN.match(text, at):
        word = token[1]
        if word == "{":
            at, paths = token.end(), []
            while not (closing := re.compile(r"\s*\}").match(text, at)):
                inner, at = tree(text, at, prefix)
                paths += inner
                if comma := re.compile(r"\s*,").match(text, at):
                    at = comma.end()
            return paths, closing.end()
        if not re.fullmatch(r"\w+|\*", word):
            break
        prefix, at = (*prefix, word), token.end()
        if alias := re.compile(r"\s+as\s+\w+").match(text, at):
            at = alias.end()
        if not (joint := re.compile(r"\s*::").match(text, at)):
            break
        at = joint.end()
    return [prefix], at


def used_paths(text: str, module: tuple[str, ...]) -> set[tuple[str, ...]]:
    """Every path from the root of the crate that the code of this module names."""
    code, found = code_of(text), set()
    for start in PATH_START.finditer(code):
        if code[: start.start()].rstrip().endswith("::"):
            continue  # the middle of a path that is already read
        for path in tree(code, start.start(), ())[0]:
            base = {"crate": (), "self": module, "super": module[:-1]}[path[0]]
            rest = path[1:]
            while rest and rest[0] == "super":
                base, rest = base[:-1], rest[1:]
            found.add((*base, *rest))
    return found


def reexports(library: str) -> dict[str, str]:
    """The names that `pub use` in lib.rs lifts to the root, and the module each comes from."""
    lifted = {}
    for use in re.finditer(r"\bpub\s+use\s+(?:crate::|self::)?(?=\w)", code_of(library)):
        for path in tree(code_of(library), use.end(), ())[0]:
            lifted[path[-1]] = path[0]
    return lifted


def broken_rules(text: str, module: tuple[str, ...], lifted: dict[str, str]) -> list[str]:
    """What this module imports and must not."""
    here, wrong = module[0], []
    if here not in RANK:
        return [f"{here} is not in LAYERS: say where it stands"]
    for path in sorted(used_paths(text, module)):
        target = lifted.get(path[0], path[0]) if path else "*"
        if target == here:
            continue
        if target not in RANK:
            wrong.append(f"{'::'.join(module)} uses crate::{'::'.join(path)}, which is no module of LAYERS")
        elif RANK[target] >= RANK[here] or here not in ONLY_FOR.get(target, {here}):
            wrong.append(f"{'::'.join(module)} uses crate::{'::'.join(path)}: {here} must not use {target}")
    return wrong


def core_modules() -> list[tuple[Path, tuple[str, ...]]]:
    source = CORE / "src"
    files = [file for file in sorted(source.rglob("*.rs")) if file != source / "lib.rs"]
    parts = [file.relative_to(source).with_suffix("").parts for file in files]
    return [(file, part[:-1] if part[-1] == "mod" else part) for file, part in zip(files, parts, strict=True)]


@pytest.mark.parametrize(("file", "module"), core_modules(), ids=["::".join(module) for _, module in core_modules()])
def test_core_layers(file, module):
    lifted = reexports((CORE / "src" / "lib.rs").read_text())
    assert broken_rules(file.read_text(), module, lifted) == []


def test_core_has_modules():
    modules = {module[0] for _, module in core_modules()}
    assert {"error", "linalg", "model", "filter", "association", "tracker"} <= modules


LIFTED = {"Error": "error", "Gaussian": "gaussian"}


@pytest.mark.parametrize(
    ("module", "snippet", "culprit"),
    [
        (("linalg", "cholesky"), "use crate::gaussian::Gaussian;", "gaussian"),
        (("linalg", "cholesky"), "use crate::Gaussian;", "gaussian"),
        (("linalg", "cholesky"), "use crate::{error::{Error, Result}, filter::kalman as k};", "filter"),
        (("linalg", "cholesky"), "fn f() { let g = crate :: tracker::run(); }", "tracker"),
        (("linalg", "cholesky"), "use super::super::model::Motion;", "model"),
        (("gaussian",), "use super::scan::Scan;", "scan"),
        (("scan",), "use crate::track::Track;", "track"),
        (("event",), "use crate::state::to_bytes;", "state"),
        (("metric", "ospa"), "pub(crate) use crate::tracker::multi_target;", "tracker"),
        (("model", "motion"), "use crate::lanes::Block;", "lanes"),
        (("filter", "kalman"), "use crate::*;", "*"),
        (("filter", "kalman"), "use crate::novelty::Thing;", "novelty"),
        (("novelty",), "", "novelty"),
        (("linalg",), "fn f<'a>(x: &'a str) -> char { '\"' }\nuse crate::sim::x; // \"", "sim"),
    ],
)
def test_core_check_fails_on(module, snippet, culprit):
    wrong = broken_rules(snippet, module, LIFTED)
    assert len(wrong) == 1
    assert culprit in wrong[0]


@pytest.mark.parametrize(
    ("module", "snippet"),
    [
        (
            ("tracker", "multi_target"),
            "use crate::{Error, Gaussian, error::Result, filter::{extended, kalman}};\nuse super::lifecycle;",
        ),
        (("filter", "kalman"), "use crate::lanes::Block;"),
        (
            ("linalg", "cholesky"),
            '// use crate::sim::x;\n/* crate::sim */ const TEXT: &str = "crate::sim::x";\n//! [`crate::sim`]',
        ),
        (("linalg", "cholesky"), 'const TEXT: &str = r#"crate::sim::x "quoted" "#;'),
        (
            ("linalg", "cholesky"),
            "#[cfg(test)]\n#[allow(clippy::unwrap_used)]\nmod tests { fn f() { crate::sim::run(); } }",
        ),
        (
            ("model", "sensor", "position"),
            "use super::super::motion::Motion; use super::{Sensor, self as s}; use self::x::y;",
        ),
    ],
)
def test_core_check_accepts(module, snippet):
    assert broken_rules(snippet, module, LIFTED) == []


# --- no Python in the core -------------------------------------------------------------------------------------------

PYTHON_WORDS = re.compile(r"pyo3|numpy|python|trackrs-py|trackrs_py", re.IGNORECASE)


def python_words(text: str) -> list[str]:
    return [line.strip() for line in text.splitlines() if PYTHON_WORDS.search(line)]


def test_core_knows_no_python():
    files = [CORE / "Cargo.toml", *CORE.rglob("*.rs")]
    assert {str(file.relative_to(ROOT)): words for file in files if (words := python_words(file.read_text()))} == {}


def test_python_check_fails_on_a_dependency():
    assert python_words('[dependencies]\npyo3 = "0.30"\n') == ['pyo3 = "0.30"']


# --- the Python side -------------------------------------------------------------------------------------------------

# The one test that looks at the compiled module itself.
MAY_SEE_THE_COMPILED_MODULE = {"tests/test_facade.py"}


def imported(source: str, package: tuple[str, ...]) -> set[str]:
    """The dotted names that this source imports; `package` is the package it stands in, for relative imports."""
    names = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else ()
            module = ".".join([*base, *([node.module] if node.module else [])])
            names |= {f"{module}.{alias.name}" for alias in node.names}
    return names


def touches_compiled(names: set[str]) -> list[str]:
    return sorted(name for name in names if "_trackrs" in name.split("."))


def leaves_package(names: set[str]) -> list[str]:
    return sorted(name for name in names if name.split(".")[0] in {"tests", "examples", "benchmarks", "conftest"})


def test_only_the_package_imports_the_compiled_module():
    files = [file for folder in ("tests", "examples", "benchmarks") for file in (ROOT / folder).rglob("*.py")]
    names = {file.relative_to(ROOT).as_posix(): touches_compiled(imported(file.read_text(), ())) for file in files}
    assert {file for file, found in names.items() if found} <= MAY_SEE_THE_COMPILED_MODULE


def test_the_package_stands_alone():
    for file in PACKAGE.rglob("*.py"):
        package = ("trackrs", *file.relative_to(PACKAGE).parts[:-1])
        assert leaves_package(imported(file.read_text(), package)) == [], file


def test_python_checks_fail_on_bad_imports():
    assert touches_compiled(imported("from trackrs import _trackrs", ())) == ["trackrs._trackrs"]
    assert touches_compiled(imported("import trackrs._trackrs as core", ())) == ["trackrs._trackrs"]
    assert touches_compiled(imported("from .. import _trackrs", ("trackrs", "io"))) == ["trackrs._trackrs"]
    assert touches_compiled(imported("from ._trackrs import x", ("trackrs",))) == ["trackrs._trackrs.x"]
    assert leaves_package(imported("def f():\n    from tests.helpers import x", ("trackrs",))) == ["tests.helpers.x"]
