"""The command line: ``sweepopt run SCENE``, ``list``, ``effects``, ``study`` and ``compare``.

It parses, runs, and hands the run to `fem.output` and `fem.pictures`. What a command needs is
imported when it runs, so that the list works with the core install.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time as clock
import warnings
from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sweepopt import __version__
from sweepopt.checks import count
from sweepopt.display import as_lines
from sweepopt.driver import finish, start
from sweepopt.errors import (
    Status,
    SweepoptError,
    UnstableStepError,
    suggestion,
)
from sweepopt.integrate import SolveOptions, schemes
from sweepopt.io import find_scene, find_study, folder_at, list_scenes, read_toml
from sweepopt.problem import Norms
from sweepopt.results import netcdf_package, require_bound
from sweepopt.velocity import PATHS, Plan, solvers

if TYPE_CHECKING:
    from sweepopt.fem import Scene
    from sweepopt.fem.output import Report

STUDY_PROBLEMS = Path(__file__).parent / "study" / "problems.toml"
"""Problems of studies that are no scenes."""

TABLE, DIAGRAM, REPORT = "table.csv", "diagram.png", "report.html"  # of a study


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command and return its exit code.

    1 if a step missed tol, and what was certified before it is written, or if the results are in a
    temporary folder, as theirs is full; 2 if it is refused, as by argparse; 130 after Ctrl-C.

    Parameters
    ----------
    arguments : sequence of str, optional
        Those of the command line by default.
    """
    parser, commands = _parser()
    word = next(iter(sys.argv[1:] if arguments is None else arguments), "-")
    if word not in commands and not word.startswith("-"):
        near = suggestion(word, commands)
        parser.error(f"there is no command {word}, but {', '.join(commands)}{near}")
    options, unknown = parser.parse_known_args(arguments)
    if unknown:
        word, names = unknown[0], vars(options).keys() - {"command", "scene", "study"}
        known = [f"--{name}".replace("_", "-") for name in names]
        hint = suggestion(word, known) or f"; there are: {', '.join(sorted(known)) or 'none'}"
        if word in known:
            hint = "; put it after the command"
        if not word.startswith("-"):
            hint = "; give one SCENE or STUDY, and words with blanks in quotes: --set 'PATH=a b'"
        parser.error(f"unrecognized argument {word}{hint}")
    try:
        with warnings.catch_warnings():  # as one line without a source file
            warnings.showwarning = lambda message, *_: _say(f"warning: {message}")
            code = options.command(options) or 0
            print(end="", flush=True)
            return code
    except UnstableStepError as error:
        # the rest of its advice is for callers of solve
        _say(f"{str(error).partition(', or say')[0]}; use --steps or --scheme")
    except SweepoptError as error:
        _say(str(error))
    except BrokenPipeError:  # the reader has enough, as head; Python shall not flush at its end
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except OSError as error:
        where = f"{error.filename}: " if error.filename else ""
        _say(f"{where}{error.strerror or error}")
    except KeyboardInterrupt:
        print(file=sys.stderr)
        _say("interrupted; nothing more was written")
        return 130
    return 2


def _parser() -> tuple[argparse.ArgumentParser, list[str]]:
    """The parser, and the names of the commands."""
    parser = argparse.ArgumentParser(
        prog="sweepopt", description="Quasistatic evolution with friction, with certificates."
    )
    parser.add_argument("--version", action="version", version=__version__)
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    listing = commands.add_parser("list", help="list the scenes that come with the library")
    listing.set_defaults(command=_list)

    run = commands.add_parser("run", help="simulate a scene and write its results")
    run.set_defaults(command=_run)
    run.add_argument("--out", type=Path, metavar="FOLDER", help="default: results/<scene name>")
    _add_changes(run)
    run.add_argument("--steps", type=int, help="number of equal steps")
    run.add_argument("--scheme", help=f"auto, {', '.join(schemes.SCHEMES)}")
    run.add_argument("--solver", help=f"auto, {', '.join(solvers.REGISTRY)}")
    run.add_argument("--tol", type=float, help="bound of each step's relative certificate")
    run.add_argument("--path", help=", ".join(PATHS))
    run.add_argument("--animate", action="store_true", help="write an animation too, as a GIF")
    words = "bound the error of the whole run too, in the norm of A: takes longer than the run"
    run.add_argument("--bound", action="store_true", help=words)
    run.add_argument("--no-progress", action="store_true", help="no progress bar")

    effects = commands.add_parser("effects", help="what each effect of a scene costs")
    effects.set_defaults(command=_effects)
    _add_changes(effects)
    effects.add_argument("--steps", type=int, default=5, help="of each run; the median is shown")

    study = commands.add_parser("study", help="what accuracy costs, run by run; resumable")
    study.set_defaults(command=_study)
    study.add_argument(
        "study", metavar="STUDY", help="a TOML file, accuracy, hard, mesh, stiff, or tolerance"
    )
    study.add_argument("--out", type=Path, metavar="FOLDER", help="default: results/<study name>")
    where = study.add_mutually_exclusive_group()
    where.add_argument("--workers", type=int, metavar="N", help="processes; default: none, serial")
    where.add_argument("--scheduler", metavar="ADDRESS", help="of a running dask scheduler")

    compare = commands.add_parser("compare", help="all solvers on the programs of a scene")
    compare.set_defaults(command=_compare)
    compare.add_argument("scene", metavar="SCENE", help="a TOML file, a name, or as P09 in studies")
    compare.add_argument("--steps", type=int, default=50, help="of the run that has the programs")
    compare.add_argument("--csv", type=Path, metavar="FILE", help="write the rows too")
    return parser, [*commands.choices]


def _add_changes(parser: argparse.ArgumentParser) -> None:
    """A scene, and the options that change it."""
    known = "a TOML file, or a name from `sweepopt list`"
    parser.add_argument("scene", metavar="SCENE", help=known)
    several: Any = {"action": "append", "default": []}
    words = "another value (TOML), such as effects.friction.g=0.5; may be repeated"
    parser.add_argument("--set", **several, metavar="PATH=VALUE", help=words)
    words = "leave an effect out: friction, traction[0]; may be repeated"
    parser.add_argument("--without", **several, metavar="EFFECT", help=words)


def _list(_: argparse.Namespace) -> None:
    problems = list_scenes()
    width = max(map(len, problems), default=0)
    for name, title in problems.items():
        print(f"{name:<{width}}  {title}".rstrip())
        print(f"{'':<{width}}  effects: {', '.join(read_toml(find_scene(name))['effects'])}")


def _effects(options: argparse.Namespace) -> None:
    path = _readable(find_scene(options.scene))
    from sweepopt.fem.scene_file import effect_costs, parse_changes

    costs = effect_costs(path, parse_changes(options.set), options.without, options.steps)
    table = [["", *costs["all effects"]]]
    for name, cost in costs.items():
        table.append([name, *(f"{x:.1e}" if type(x) is float else str(x) for x in cost.values())])
    widths = [max(map(len, column)) for column in zip(*table, strict=True)]
    for row in table:
        print("  ".join(f"{word:>{width}}" for word, width in zip(row, widths, strict=True)))


def _study(options: argparse.Namespace) -> None:
    """Run a study, or go on with it, then its hard and stiff cases, and write what they say."""
    path = _readable(find_study(options.study))
    if options.workers is not None:
        count("--workers", options.workers)
    from sweepopt import study as room
    from sweepopt.study.hard import run_suite, suite_summary
    from sweepopt.study.report import fastest_runs
    from sweepopt.study.study import read_parts

    folder = options.out or Path("results") / path.stem
    data, parts = read_parts(path)
    table, solutions, files = None, {}, []
    suites = {}
    folder_at("--out", folder)
    if not parts or data.keys() - {"title"}:
        study = room.read_study(path)
        executor: Any = nullcontext()
        if options.scheduler is not None:
            executor = room.dask_executor(options.scheduler)
        elif options.workers is not None:
            executor = room.processes(options.workers)
        with executor as pool:
            table = room.run(study, folder, executor=pool, progress=_note)
        table.to_csv(folder / TABLE, index=False)
        room.work_precision(table).figure.savefig(folder / DIAGRAM)
        solutions = fastest_runs(study, table)
        print(room.summary(table))
        files += [TABLE, DIAGRAM]
    for name, suite in parts.items():
        # in this process, from the start: hard cases take some minutes a seed
        lines = folder / f"{name}.csv"
        suites[name] = run_suite(suite, lines, _note)
        if suites[name]:
            print(suite_summary(suites[name]))
            files.append(lines.name)
    title = str(data.get("title", path.stem))
    room.write_report(table, folder / REPORT, solutions=solutions, title=title, **suites)
    print(f"written: {folder}: {', '.join([*files, REPORT])}")


def _compare(options: argparse.Namespace) -> None:
    """Compare all solvers on the programs of a scene."""
    if options.scene not in read_toml(STUDY_PROBLEMS):
        _readable(find_scene(options.scene))
    from sweepopt.study import compare, comparison_text

    if options.csv is not None:
        options.csv.touch()  # says so now if it cannot be written
    table = compare(options.scene, steps=options.steps, progress=_note)
    print(comparison_text(table))
    if options.csv is not None:
        table.to_csv(options.csv, index=False)


def _run(options: argparse.Namespace) -> int:
    path = _readable(find_scene(options.scene))
    from sweepopt.fem import output, pictures, read_scene
    from sweepopt.fem.scene_file import parse_changes
    from sweepopt.plot import new_figure

    netcdf_package(), new_figure((1.0, 1.0))  # what is not installed is told before the run
    given = {name: getattr(options, name) for name in ("steps", "scheme", "solver", "tol", "path")}
    scene = read_scene(path, changes=parse_changes(options.set), without=options.without)
    scene = replace(scene, **{name: value for name, value in given.items() if value is not None})
    picture_files = [f"{name}.png" for name in pictures.pictures_of(scene)]
    if options.animate:
        picture_files.append(f"{pictures.choose(scene, '', pictures.FIELDS)}.gif")
    folder = folder_at("--out", options.out or Path("results") / path.stem)
    process, started = scene.process, clock.perf_counter()
    solving = SolveOptions(
        *(scene.t_end, scene.steps, scene.scheme, scene.solver, scene.tol, scene.path),
        on_failure="stop",
        progress=not options.no_progress,
    )
    run = start(process, solving)
    norms = None
    if options.bound:  # what no bound is known of is refused before the run
        require_bound(process, run.plan)
        norms = Norms(process)
    _announce(scene, run.plan)

    text = path.read_text(encoding="utf-8")
    text += "".join(f"\n# changed: {change}" for change in scene.changes)
    solution = finish(process, solving, run)
    seconds, code = clock.perf_counter() - started, int(not solution.success)
    if len(solution.steps):
        report = output.Report(scene, solution, name=path.stem, text=text, seconds=seconds)
        try:
            files = output.write(report, folder, picture_files)
        except OSError as error:  # a full disk: the run is not lost if there is another
            _say(f"{folder}: the results cannot be written there ({error.strerror or error})")
            folder, code = Path(tempfile.mkdtemp(prefix=f"sweepopt-{path.stem}-")), 1
            files = output.write(report, folder, picture_files)
        _conclude(report, folder, files)
        if norms is not None:
            bound = solution.error_bound()
            beside = f"in the norm of {'B' if norms.weak else 'A'}, where the largest u has"
            words = f"{bound!r} {beside} {norms.A(solution.u).max():.4g}"
            print(as_lines([("error bound", words)]))
    else:
        _say(f"no step was completed, nothing is written. {solution.message}")
    return 130 if solution.status is Status.INTERRUPTED else code


def _announce(scene: Scene, plan: Plan) -> None:
    """Print what will be simulated and what will not."""
    if scene.title:
        print(scene.title)
    from sweepopt.fem.output import unit_of_time

    unit, seconds = unit_of_time(scene, scene.t_end)
    time = "time", f"0 to {scene.t_end / seconds:.5g}{unit} in {scene.steps} steps"
    print(as_lines([*(("changed", change) for change in scene.changes), time]))
    print(replace(plan, left_out=(*scene.left_out, *plan.left_out)), flush=True)


def _conclude(report: Report, folder: Path, files: Sequence[str]) -> None:
    """Print how the run went and where its files are."""
    from sweepopt.fem.output import largest

    solution, energy = report.solution, report.energy
    meter, joule = map(report.suffix, ("length", "energy"))
    sliding = ""
    if report.slip is not None:
        slip = report.slip.statistics()
        sliding = "no point of the contact slips"
        if slip.time_of_most is not None:
            sliding = (
                f"{100 * slip.ever:.0f} % of the contact slips at some time, "
                f"{100 * slip.most:.0f} % at once, {report.moment(slip.time_of_most)}"
            )
    spent = f"friction and yielding {energy.friction[-1]:.4g}{joule}"
    named = [name for name in files if not name.endswith(".vtu")]
    lines = {
        "status": solution.message,
        "reached": f"{report.moment(solution.t[-1])} in {len(solution.steps)} steps, "
        f"{report.seconds:.3g} s of computing",
        "max displacement": f"{largest(report)['value']:.4g}{meter}",
        "slip": sliding,
        "energy": f"{spent}; the others are not known where a displacement is prescribed"
        if report.scene.lifts
        else f"work {energy.work[-1]:.4g}{joule} = stored {energy.stored[-1]:.4g} "
        f"+ viscous {energy.viscous[-1]:.4g} + {spent}; balance error {energy.balance[-1]:.1e}",
        "worst certificate": f"{solution.stats['relative'].max():.1e} (relative)",
        "written": f"{folder}: {', '.join(named)}",
    }
    print(as_lines(lines.items()))


def _readable(path: Path) -> Path:
    """The path of a file that can be read: a wrong name is told before what is not installed."""
    read_toml(path)
    return path


def _say(message: str) -> None:
    _note(f"sweepopt: {message}")


def _note(words: str) -> None:
    print(words, file=sys.stderr, flush=True)
