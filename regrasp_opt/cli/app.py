"""The command line. Heavy modules are imported by the command that needs them, so that `--help` is instant."""

from __future__ import annotations

import logging
import os
import platform
import sys
import time
import traceback
from importlib.metadata import version
from typing import Annotated

import typer

from regrasp_opt.cli import interrupts
from regrasp_opt.cli.planning_commands import check, inspect, plan, prepare
from regrasp_opt.cli.result_commands import bench, export, motion, show
from regrasp_opt.errors import RegraspError
from regrasp_opt.files import data_home

logger = logging.getLogger(__name__)

app = typer.Typer(
    name="regrasp-opt",
    help="Plan regrasps: the intermediate poses at which a robot must put an object down to get it from start to goal.",
    invoke_without_command=True,
    rich_markup_mode="rich",
    context_settings={"help_option_names": ["-h", "--help"]},
)
_state = {"debug": False}


def run(arguments: list[str]) -> int:
    """Run the command line on `arguments` and return the exit code."""
    began = time.perf_counter()
    if any(not word or (word.startswith("--") and word.find("=") == len(word) - 1) for word in arguments):
        return _fail("an argument is empty, perhaps because a variable is not set; give it a value, or omit it")
    try:
        result = app(args=arguments, standalone_mode=False)
    except typer.TyperException as error:
        return _fail(error.format_message(), error)
    except RegraspError as error:
        return _fail(str(error), error)
    except OSError as error:
        return _fail(f"{error.strerror or error}: {error.filename}" if error.filename else str(error), error)
    except MemoryError as error:
        return _fail("there is not enough memory for this; ask for fewer samples, grasps or regrasps", error)
    except Exception as error:  # the last resort: a defect of ours must not spill a traceback either
        return _fail(f"internal error ({type(error).__name__}: {error}); run again with --debug and report it", error)
    except KeyboardInterrupt:
        return interrupts.conclude()
    logger.info("took %.2f s", time.perf_counter() - began)
    if interrupts.received():  # Typer makes an exit code of it
        return interrupts.conclude()
    return result if isinstance(result, int) else 0


def _fail(message: str, error: BaseException | None = None) -> int:
    if interrupts.received():  # what a library made of the interrupt that it caught
        return interrupts.conclude()
    if _state["debug"] and error is not None:
        traceback.print_exception(error)
    print(f"error: {' '.join(message.split())}", file=sys.stderr)
    return 2


def _show_version(wanted: bool) -> None:
    if wanted:
        print(f"regrasp-opt {version('regrasp-opt')}")
        raise typer.Exit()


@app.callback()
def _common(
    context: typer.Context,
    debug: Annotated[bool, typer.Option("--debug", help="Show tracebacks.")] = False,
    verbose: Annotated[bool, typer.Option("--verbose", "-v", help="Log each step to stderr.")] = False,
    show_version: Annotated[
        bool, typer.Option("--version", callback=_show_version, is_eager=True, help="Show the version.")
    ] = False,
) -> None:
    _state["debug"] = debug or bool(os.environ.get("REGRASP_OPT_DEBUG"))
    logging.basicConfig(level=logging.INFO if verbose else logging.WARNING, format="%(name)s: %(message)s")
    system = f"Python {platform.python_version()} on {platform.system()} {platform.machine()}"
    logger.info("regrasp-opt %s, %s, data in %s", version("regrasp-opt"), system, data_home())
    if context.invoked_subcommand is None:
        print(context.get_help())


for command in (plan, prepare, inspect, check, motion, show, export, bench):
    app.command()(command)
