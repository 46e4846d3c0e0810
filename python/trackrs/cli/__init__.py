"""The command `trackrs`.

A user's mistake is one line on stderr and exit code 2. Needs click, polars and rich: `pip install "trackrs[cli]"`.
"""

from __future__ import annotations

import sys
from importlib.util import find_spec
from typing import TYPE_CHECKING

from trackrs._trackrs import __version__
from trackrs.errors import InternalError, TrackrsError

if TYPE_CHECKING:
    from collections.abc import Sequence

NEEDS = ("click", "polars", "rich")


def main(args: Sequence[str] | None = None) -> int:
    """Run the command and return its exit code: 0, 2 for a user's mistake, 130 after Ctrl-C, 1 for a fault of trackrs.

    Args:
        args: the arguments; those of the process if not given.
    """
    missing = [name for name in NEEDS if find_spec(name) is None]
    if missing:
        return _fail(f'the command line needs {" and ".join(missing)}: pip install "trackrs[cli]"')
    try:
        return _run(args)
    except KeyboardInterrupt:
        return 130


def _run(args: Sequence[str] | None) -> int:
    import click

    from trackrs.cli.evaluate import evaluate
    from trackrs.cli.reproduce import reproduce
    from trackrs.cli.study import study
    from trackrs.cli.track import track

    group = click.Group(
        "trackrs",
        commands=[track, evaluate, study, reproduce],
        help="Target tracking: from detections to tracks with honest covariances.",
        context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
        no_args_is_help=False,
    )
    group = click.version_option(__version__, message="trackrs %(version)s")(group)
    try:
        result = group.main(args, prog_name="trackrs", standalone_mode=False)
    except click.UsageError as error:
        path = error.ctx.command_path if error.ctx else "trackrs"
        text = error.format_message().rstrip(".")
        return _fail(f"{text[:1].lower()}{text[1:]} (see {path} --help)")
    except click.ClickException as error:
        return _fail(error.format_message())
    except click.Abort:
        return 130
    except InternalError as error:
        return _fail(str(error), code=1)
    except TrackrsError as error:
        return _fail(str(error))
    except ImportError as error:
        if "trackrs[" not in str(error):
            raise
        return _fail(str(error))
    return result if isinstance(result, int) else 0


def _fail(text: str, code: int = 2) -> int:
    print(f"trackrs: error: {' '.join(text.split())}", file=sys.stderr)  # noqa: T201 (click may be missing)
    return code
