"""The facade wraps everything the compiled module exports, and keeps its promises about types, imports and safety."""

from __future__ import annotations

import ast
import inspect
import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

import trackrs
from trackrs import _trackrs

ROOT = Path(__file__).resolve().parent.parent
PACKAGE = ROOT / "python" / "trackrs"
BINDINGS = ROOT / "rust" / "trackrs-py" / "src"

# --- every export is wrapped -----------------------------------------------------------------------------------------


def exports(module) -> set[str]:
    """The public names of the compiled module, methods and properties of its classes included."""
    names = set()
    for name, value in vars(module).items():
        if name.startswith("_"):
            continue
        names.add(name)
        if inspect.isclass(value) and not issubclass(value, BaseException):
            names |= {f"{name}.{member}" for member in vars(value) if not member.startswith("_")}
    return names


def names_in(source: str) -> set[str]:
    """Every identifier in this source, attributes and imports included."""
    names = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Name):
            names.add(node.id)
        elif isinstance(node, ast.Attribute):
            names.add(node.attr)
        elif isinstance(node, ast.alias):
            names |= set(node.name.split("."))
    return names


def unwrapped(exported: set[str], sources: list[str]) -> list[str]:
    used = set().union(*map(names_in, sources))
    return sorted(name for name in exported if name.split(".")[-1] not in used)


def test_every_export_is_used_by_the_package():
    exported = exports(_trackrs)
    assert exported
    assert unwrapped(exported, [file.read_text() for file in PACKAGE.rglob("*.py")]) == []


def test_an_unused_export_is_found():
    sources = ["from trackrs._trackrs import assign\nfilter.update()", "# orphan, Filter.orphan"]
    assert unwrapped({"assign", "orphan", "Filter.update", "Filter.orphan"}, sources) == ["Filter.orphan", "orphan"]


# --- every class of the compiled module is frozen --------------------------------------------------------------------

NOT_FROZEN: set[str] = set()  # classes that may change in place, with the reason; none so far

PYCLASS = re.compile(
    r"#\[(?:pyo3::)?pyclass\s*(?:\((?P<options>[^\]]*)\))?\s*\](?P<between>.*?)\b(?:struct|enum)\s+(?P<name>\w+)",
    re.DOTALL,
)


def unfrozen(source: str) -> list[str]:
    code = re.sub(r"//[^\n]*", "", source)
    found = list(PYCLASS.finditer(code))
    assert len(found) == len(re.findall(r"\bpyclass\b(?=\s*[\](])", code)), "a #[pyclass] that this test cannot read"
    return [
        each["name"]
        for each in found
        if "frozen" not in re.split(r"[\s,]+", each["options"] or "") and each["name"] not in NOT_FROZEN
    ]


@pytest.mark.parametrize("file", sorted(BINDINGS.rglob("*.rs")), ids=lambda file: file.name)
def test_every_pyclass_is_frozen(file):
    assert unfrozen(file.read_text()) == []


def test_an_unfrozen_pyclass_is_found():
    bare = "/// Doc.\n#[pyclass]\npub(crate) struct Bare;"
    options = '#[pyo3::pyclass(name = "Filter", module = "trackrs")]\n#[derive(Clone)]\nstruct Options { x: f64 }'
    good = "#[pyclass(frozen, eq)]\nenum Good { A }"
    assert unfrozen(f"{bare}\n{options}\n{good}") == ["Bare", "Options"]


# --- the public names ------------------------------------------------------------------------------------------------


def own_docstring(value) -> str:
    """What its author wrote: neither inherited nor made up by `dataclass`."""
    text = (vars(value).get("__doc__") if inspect.isclass(value) else getattr(value, "__doc__", None)) or ""
    return "" if inspect.isclass(value) and text.startswith(f"{value.__name__}(") else text.strip()


@pytest.mark.parametrize("name", [name for name in trackrs.__all__ if not name.startswith("__")])
def test_every_public_name_has_a_docstring(name):
    assert own_docstring(getattr(trackrs, name))


def test_public_names_are_listed_once():
    assert len(trackrs.__all__) == len(set(trackrs.__all__))
    assert isinstance(trackrs.__version__, str)


# --- what an import costs --------------------------------------------------------------------------------------------

STRANGERS = """
import json, sys
before = set(sys.modules)
import {module}
fresh = {{name.split(".")[0] for name in set(sys.modules) - before if getattr(sys.modules[name], "__file__", None)}}
print(json.dumps(sorted(fresh - set(sys.stdlib_module_names) - {{"trackrs", "numpy"}})))
"""


def strangers(module: str) -> list[str]:
    """The third-party packages, NumPy aside, that importing this module pulls in."""
    script = STRANGERS.format(module=module)
    return json.loads(subprocess.run([sys.executable, "-c", script], check=True, capture_output=True, text=True).stdout)


def test_import_pulls_in_numpy_alone():
    assert strangers("trackrs") == []


def test_a_stranger_is_noticed():
    assert "pytest" in strangers("pytest")


# --- nothing in the package runs what it reads -----------------------------------------------------------------------

UNSAFE_MODULES = {"pickle", "cPickle", "dill", "cloudpickle", "joblib", "marshal", "shelve", "yaml"}
UNSAFE_CALLS = {"eval", "exec", "compile", "__import__"}


def is_false(node: ast.expr) -> bool:
    return isinstance(node, ast.Constant) and node.value is False


def unsafe(source: str) -> list[str]:
    found = []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            found += [alias.name for alias in node.names if alias.name.split(".")[0] in UNSAFE_MODULES]
        elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
            found += [node.module] if node.module.split(".")[0] in UNSAFE_MODULES else []
        elif isinstance(node, ast.Call):
            found += [node.func.id] if isinstance(node.func, ast.Name) and node.func.id in UNSAFE_CALLS else []
            found += [key.arg for key in node.keywords if key.arg == "allow_pickle" and not is_false(key.value)]
    return found


@pytest.mark.parametrize("file", sorted(PACKAGE.rglob("*.py")), ids=lambda file: file.relative_to(PACKAGE).as_posix())
def test_nothing_runs_what_it_reads(file):
    assert unsafe(file.read_text()) == []


@pytest.mark.parametrize(
    "source",
    [
        "import pickle\npickle.load(f)",
        "from yaml import load",
        "x = eval(text)",
        "exec(text)",
        "np.load(path, allow_pickle=True)",
    ],
)
def test_unsafe_reading_is_found(source):
    assert len(unsafe(source)) == 1
