"""The command ``dmptm``: bad input gives one line on stderr and exit code 2."""

import json
import os
import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from dmptm_ctrl import __version__
from dmptm_ctrl.progress import Progress, printable, show_info

BAD_INPUT = 2
OUR_FAULT = 70  # EX_SOFTWARE of sysexits.h
LONGEST = 600  # characters of a message
INTERRUPTED = 130  # 128 + SIGINT, as shells count

app = typer.Typer(
    name="dmptm",
    help="Control-design workbench for geared servo drives.",
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="markdown",  # "rich" takes units, such as [s], for marks
)
log_app = typer.Typer(help="Look at logs.")
app.add_typer(log_app, name="log")
rig_app = typer.Typer(help="Describe a drive in a file.")
app.add_typer(rig_app, name="rig")

# what several commands take
_Out = Annotated[Path, typer.Option(help="Folder for the results.")]
_Model = Annotated[Path, typer.Option(help="model.toml, as diagnose writes it.")]
_Jobs = Annotated[int, typer.Option(min=1, help="Threads.")]
_Quiet = Annotated[bool, typer.Option("--quiet", help="No summary.")]
_Real = Annotated[str, typer.Option(help="Numbers of c and st: double or float.")]
_Step = Annotated[float | None, typer.Option(help="Time between samples of the program [s].")]
_Picture = Annotated[Path, typer.Option(help="Picture: .png, .svg or .pdf.")]
_Own = Annotated[
    Path | None,
    typer.Argument(
        metavar="[FILE]", help="Your drive: a rig.toml, or a model.toml of a diagnosis."
    ),
]
_Input = Annotated[str | None, typer.Option("--input", help="Input of your rig; else its first.")]
_Output = Annotated[
    str | None, typer.Option("--output", help="Sensor of your rig; else its first speed.")
]


def _print_version(wanted: bool) -> None:
    if wanted:
        print(f"dmptm {__version__}")
        raise typer.Exit


@app.callback(invoke_without_command=True)
def _main(
    context: typer.Context,
    version: Annotated[
        bool,
        typer.Option(
            "--version", callback=_print_version, is_eager=True, help="Show the version and exit."
        ),
    ] = False,
) -> None:
    if context.invoked_subcommand is None:
        print(context.get_help())


@app.command()
def diagnose(
    logs: Annotated[list[Path], typer.Argument(help="A folder of logs of one rig, or the files.")],
    out: _Out = Path("diagnosis"),
    rig: Annotated[
        Path | None, typer.Option(help="rig.toml: the declared model; else the paper's rig.")
    ] = None,
    jobs: _Jobs = 2,
    seed: Annotated[int, typer.Option(help="Kept in the provenance.")] = 0,
    quiet: Annotated[bool, typer.Option("--quiet", help="No summary, no progress.")] = False,
    log_json: Annotated[
        bool, typer.Option("--log-json", help="Progress and warnings as JSON lines on stderr.")
    ] = False,
) -> None:
    """Name the physical effect that the declared model lacks."""
    from dmptm_ctrl.signals.atomic import check_folder

    check_folder(out)  # not after a minute of work

    with Progress(quiet=quiet, as_json=log_json) as progress:
        progress.stage("loading the program")
        from dmptm_ctrl.diagnosis.run import diagnose as run

        progress.stage("reading and diagnosing the logs")
        paths = logs[0] if len(logs) == 1 else logs
        result = run(paths, rig, jobs=jobs, seed=seed, progress=progress.stage)
        progress.stage("writing the report")
        result.save(out)
        for warning in result.warnings:
            progress.warn(printable(warning))
        progress.done(verdict=result.verdict, effects=[effect.name for effect in result.effects])
    if not quiet:
        lines = result.summary().splitlines()
        print("\n".join(line for line in lines if not line.startswith("warning: ")))
        print(f"\nwritten to {out}: report.html, diagnosis.json, model.toml")


@app.command()
def predict(
    log: Annotated[Path, typer.Argument(help="A log of the rig; of it the inputs are used.")],
    model: _Model,
    out: Annotated[Path, typer.Option(help="CSV to write.")] = Path("pred.csv"),
    single: Annotated[
        bool,
        typer.Option(
            "--single",
            help="One run with its impact chatter, not the mean of runs with nearly equal meshes.",
        ),
    ] = False,
) -> None:
    """Run the plant model freely on a log's inputs."""
    from dmptm_ctrl.diagnosis.run import predict_file
    from dmptm_ctrl.signals.atomic import write_atomic

    notes: list[str] = []
    content, errors = predict_file(log, model, single=single, notes=notes)
    write_atomic(out, content)
    for text in notes:
        Progress().warn(text)
    print(f"{printable(errors)}\nwritten to {out}")


@app.command()
def tune(
    model: Annotated[Path, typer.Argument(help="model.toml of diagnose, or a rig.toml.")],
    out: _Out = Path("tuning"),
    uncertainty: Annotated[
        float, typer.Option(min=0.0, max=1.0, help="Share of the declared ranges still open.")
    ] = 0.25,
    logs: Annotated[
        Path | None, typer.Option(help="Logs of the machine: they show how friction builds up.")
    ] = None,
    plants: Annotated[int, typer.Option(min=16, help="Plants drawn to judge it on.")] = 1000,
    limit: Annotated[float | None, typer.Option(help="Of each input [V or SI].")] = None,
    speed: Annotated[float | None, typer.Option(help="Largest setpoint [rad/s or m/s].")] = None,
    input: Annotated[str, typer.Option(help="Input of the loop, by its name.")] = "",
    sensor: Annotated[str, typer.Option(help="Sensor of the loop, by its name.")] = "",
    sample_time: _Step = None,
    seed: Annotated[int, typer.Option(help="Of the drawn plants.")] = 0,
    jobs: _Jobs = 2,
    quiet: _Quiet = False,
) -> None:
    """Design a speed controller on a model and its uncertainty."""
    from dmptm_ctrl.design.run import tune_file
    from dmptm_ctrl.identify.build_up import with_build_up
    from dmptm_ctrl.signals import load_logs
    from dmptm_ctrl.signals.atomic import check_folder

    check_folder(out)
    known = () if logs is None else load_logs(logs)
    with Progress(quiet=quiet) as progress:
        progress.stage(f"designing on {model.name} and judging on {plants} drawn plants")
        tuned = tune_file(
            model, out, uncertainty=uncertainty, plants=plants, seed=seed, jobs=jobs,
            refine=(lambda drive: with_build_up(drive, known, jobs=jobs)) if known else None,
            input=input, sensor=sensor, limit=limit, speed=speed, sample_time=sample_time or 1e-3,
        )  # fmt: skip
    if not quiet:
        print(tuned.summary())
        print(f"\nwritten to {out}: controller.toml, tuning.json, tuning.png")


@app.command()
def check(
    logs: Annotated[list[Path], typer.Argument(help="A folder of new logs, or the files.")],
    model: _Model,
    out: Annotated[Path | None, typer.Option(help="Folder for check.json and trend.png.")] = None,
    tolerance: Annotated[float, typer.Option(help="Share by which an entry may differ.")] = 0.05,
    jobs: _Jobs = 2,
    quiet: _Quiet = False,
) -> int:
    """Is the machine still the one that a model describes? Exit code 0: yes, 1: no."""
    from dmptm_ctrl.check.run import check_files

    found = check_files(logs, model, out, tolerance=tolerance, jobs=jobs)
    if not quiet:
        print(printable(found.summary()))
    return 0 if found.same else 1


@app.command()
def export(
    model: Annotated[Path, typer.Argument(help="model.toml of diagnose, controller.toml of tune.")],
    to: Annotated[str, typer.Option(help="c, st, fmu, python, table or mujoco.")],
    out: _Out = Path("export"),
    real: _Real = "double",
    sample_time: _Step = None,
    name: Annotated[str | None, typer.Option(help="Of the program in its code.")] = None,
) -> None:
    """Write a model or a controller as a program where users run it."""
    from dmptm_ctrl.export.run import export_file

    names = export_file(model, to, out, real=real, sample_time=sample_time, name=name)
    print(f"written to {out}: {', '.join(names)}")


@app.command()
def experiment(
    signals: Annotated[Path, typer.Argument(help="next_experiment.csv of diagnose.")],
    to: Annotated[str, typer.Option(help="csv, c or st (IEC 61131-3).")] = "csv",
    out: _Out = Path("experiment"),
    model: Annotated[Path | None, typer.Option(help="model.toml: for speed, travel.")] = None,
    max_signal: Annotated[float, typer.Option(help="Of an input [V or SI].")] = float("inf"),
    max_speed: Annotated[float, typer.Option(help="Of the load [rad/s or m/s].")] = float("inf"),
    max_travel: Annotated[float, typer.Option(help="Of the load [rad or m].")] = float("inf"),
    sample_time: _Step = None,
    real: _Real = "double",
) -> None:
    """Write the next experiment ready to run, inside the limits of the rig."""
    from dmptm_ctrl.export.experiment import Limits
    from dmptm_ctrl.export.run import export_experiment

    limits = Limits(max_signal, max_speed, max_travel)
    names = export_experiment(
        signals, to, out, limits=limits, model=model, real=real, sample_time=sample_time
    )
    print(f"written to {out}: {', '.join(names)}")


@app.command()
def reproduce(
    out: Annotated[Path, typer.Option(help="Folder for page, figures, tables.")] = Path(
        "reproduction"
    ),
    quiet: Annotated[bool, typer.Option("--quiet", help="No progress bar.")] = False,
) -> None:
    """Make every figure and table of the paper, and a page that shows them."""
    from dmptm_ctrl.reproduce import reproduce as make

    page = make(out, quiet=quiet)
    if not quiet:
        print(f"written: {page}")


@app.command()
def resonances(
    values: Annotated[
        list[str] | None, typer.Option("--set", metavar="NAME=VALUE", help="In SI; repeatable.")
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="Folder for pictures and tables as files.")
    ] = None,
) -> None:
    """Show frequencies, shapes, classes and sensitivities of the drive's modes."""
    from dmptm_ctrl.reproduce.resonances import overridden, resonance_items, show
    from dmptm_ctrl.signals.atomic import output_folder

    try:
        drive, extra = overridden(dict(_assignment(text) for text in values or ()))
    except ValueError as error:
        raise typer.BadParameter(str(error)) from None
    items = resonance_items(drive, **extra)
    show(items)
    if out is not None:
        from dmptm_ctrl.reproduce.items import save_items

        with output_folder(out) as folder:
            save_items(folder, items)
        print(f"written to {out}")


@app.command()
def bode(
    file: _Own = None,
    out: _Picture = Path("bode.png"),
    input: _Input = None,
    output: _Output = None,
    low: Annotated[float, typer.Option(min=1e-6, help="From this frequency [Hz].")] = 0.1,
    high: Annotated[float, typer.Option(min=1e-6, help="To this one [Hz].")] = 1000.0,
) -> None:
    """Draw the 9-DOF, 3-DOF and baseline models and your own drive in one Bode plot."""
    if not low < high:
        raise typer.BadParameter(f"--low {low:g} must be below --high {high:g}")
    _compare("bode", (file, input, output), out, low, high)


@app.command()
def step(
    file: _Own = None,
    out: _Picture = Path("step.png"),
    input: _Input = None,
    output: _Output = None,
    seconds: Annotated[float, typer.Option(min=1e-6, help="Length of the picture.")] = 2.0,
) -> None:
    """Draw steps of the 9-DOF, 3-DOF and baseline models and your own drive."""
    _compare("step", (file, input, output), out, seconds)


def _compare(
    kind: str, own: tuple[Path | None, str | None, str | None], out: Path, *limits: float
) -> None:
    """Draw the paper's models and the user's own, and print their numbers."""
    import warnings

    from dmptm_ctrl.reproduce import compare

    file, input, output = own
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always", UserWarning)
        models = compare.linear_models(file, input=input, output=output)
    for warning in said:
        print(f"warning: {printable(str(warning.message))}", file=sys.stderr)
    draw: Any = getattr(compare, kind)
    figure, numbers = draw(models, *limits)
    _save_picture(figure, out)
    print(f"{printable(numbers)}\n\nwritten: {out}")


def _assignment(text: str) -> tuple[str, float]:
    name, equals, value = text.partition("=")
    if not equals:
        raise ValueError(f"{text!r} is not NAME=VALUE")
    try:
        return name.strip(), float(value)
    except ValueError:
        raise ValueError(f"{name.strip()} is {value!r}, it must be a number") from None


@log_app.command("info")
def log_info(
    file: Annotated[
        Path, typer.Argument(help="Log: text of any kind, .mat, .parquet, .mf4, .json, …")
    ],
    as_json: Annotated[bool, typer.Option("--json", help="For programs.")] = False,
    rig: Annotated[
        Path | None, typer.Option(help="rig.toml: says what the columns are; else their names do.")
    ] = None,
) -> None:
    """Show what is in a log, and what it can and cannot identify."""
    from dmptm_ctrl.signals.info import describe, describe_file

    if rig is None:
        info = describe_file(file)
    else:
        from dmptm_ctrl.drive.rigfile import load_rig
        from dmptm_ctrl.simulate.placed_effects import PLACED_CATALOGUE

        drive = load_rig(rig)
        inputs = [source.channel for source in drive.inputs]
        declared = drive.declared_names()
        effects = [name for name, one in PLACED_CATALOGUE.items() if one.stands_in(drive)]
        info = describe(drive.read(file)[0], drive.labels(), declared, effects, inputs)
    if as_json:
        print(json.dumps(info.to_dict(), indent=2, ensure_ascii=False))
    else:
        show_info(info, declared=rig is not None)


@rig_app.command("check")
def rig_check(
    file: Annotated[Path, typer.Argument(help="A rig file; see docs/rig_toml.md.")],
    figure: Annotated[Path | None, typer.Option(help="Also draw it to this .png or .svg.")] = None,
) -> None:
    """Draw a rig file and print its modes; say what is wrong with it."""
    from dmptm_ctrl.drive.rigfile import load_rig
    from dmptm_ctrl.plots.rig import plot_rig
    from dmptm_ctrl.simulate.linear import modes_text
    from dmptm_ctrl.simulate.rig_model import declared_effects

    rig = load_rig(file)
    declared_effects(rig)
    print(printable(str(rig)))
    print(modes_text(rig))
    for caution in rig.cautions():
        print(f"warning: {printable(caution)}", file=sys.stderr)
    if figure is not None:
        _save_picture(plot_rig(rig).get_figure(root=True), figure)


def _save_picture(picture: Any, path: Path) -> None:
    """Write a figure, whole or not at all."""
    from io import BytesIO

    from dmptm_ctrl.signals.atomic import write_atomic

    if path.suffix.lower() not in (".png", ".svg", ".pdf"):
        raise typer.BadParameter(f"{path.name}: call the figure .png, .svg or .pdf")
    content = BytesIO()
    picture.savefig(content, dpi=150, format=path.suffix[1:].lower())
    write_atomic(path, content.getvalue())


@rig_app.command("init")
def rig_init(
    file: Annotated[Path, typer.Argument(help="Rig file to write.")] = Path("rig.toml"),
    force: Annotated[bool, typer.Option("--force", help="Replace a file that exists.")] = False,
    dual: Annotated[
        bool, typer.Option("--dual", help="Two motors on a ring gear, with the paper's values.")
    ] = False,
) -> None:
    """Write a commented rig file to start from."""
    from dmptm_ctrl.data import PAPER_RIG, RIG_TEMPLATE
    from dmptm_ctrl.signals import LogError
    from dmptm_ctrl.signals.atomic import write_atomic

    if file.exists() and not force:
        raise LogError(f"{file} exists; give another name, or --force to replace it")
    template = PAPER_RIG if dual else RIG_TEMPLATE
    write_atomic(file, template.read_text(encoding="utf-8"))
    print(f"written to {file}; edit it, then: dmptm rig check {file}")


def main(arguments: list[str] | None = None) -> int:
    """Run the command, with these arguments in place of the command line's; return its exit code.

    0: done; 1: `check` found a change; 2: bad input, one line on stderr; 70: an error of the
    program itself; 130: interrupted.
    """
    os.environ["MPLBACKEND"] = "Agg"  # no windows
    try:
        result = app(arguments, prog_name="dmptm", standalone_mode=False)
    except (KeyboardInterrupt, typer.Abort):
        return _fail("interrupted", INTERRUPTED)
    except BrokenPipeError:  # the reader of our output has gone, as in `dmptm … | head`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except OSError as error:
        return _fail(": ".join(str(p) for p in (error.filename, error.strerror or error) if p))
    except Exception as error:
        message = _of_bad_input(error)
        if message is not None:
            return _fail(message)
        if os.environ.get("DMPTM_DEBUG"):
            raise
        return _fail(
            f"an error of the program itself, {type(error).__name__}: {error}; please report it, "
            "with the traceback that DMPTM_DEBUG=1 shows",
            OUR_FAULT,
        )
    return result if isinstance(result, int) else 0


def _of_bad_input(error: Any) -> str | None:
    """Message of an error that the user can mend; None for one of ours."""
    from dmptm_ctrl.signals.errors import LogError

    if isinstance(error, LogError):
        return str(error)
    if hasattr(error, "format_message"):  # wrong usage, as the command-line library reports it
        path = getattr(getattr(error, "ctx", None), "command_path", "dmptm").split()
        command = " ".join(["dmptm", *path[1:]])  # however the program was called
        return f"{str(error.format_message()).rstrip('.?')}; see '{command} --help'."
    return None


def _fail(message: str, code: int = BAD_INPUT) -> int:
    line = " ".join(message[: 2 * LONGEST].split())
    if len(line) > LONGEST:  # it quotes a file, which need not be shown whole
        line = line[:LONGEST] + " …"
    print(f"dmptm: {printable(line)}", file=sys.stderr)
    return code


if __name__ == "__main__":
    sys.exit(main())
