"""A plant as an FMU: FMI 2.0 for co-simulation, with a binary for this platform and the source."""

import hashlib
import platform
import sys
import tempfile
import zipfile
from importlib.resources import files
from pathlib import Path
from xml.etree.ElementTree import Element, SubElement, indent, tostring

import dmptm_ctrl
from dmptm_ctrl.export.c_source import c_header, c_source
from dmptm_ctrl.export.native import shared_library
from dmptm_ctrl.export.program import Port, Program, ascii_text

_BASE = {  # unit -> exponents of SI base units
    "rad": {"rad": 1},
    "rad/s": {"rad": 1, "s": -1},
    "m": {"m": 1},
    "m/s": {"m": 1, "s": -1},
    "V": {"kg": 1, "m": 2, "s": -3, "A": -1},
    "A": {"A": 1},
    "N": {"kg": 1, "m": 1, "s": -2},
    "N m": {"kg": 1, "m": 2, "s": -2},
}
_YEAR = (1980, 1, 1, 0, 0, 0)  # of files in the archive: the same text gives the same archive


def write_fmu(program: Program, sample_time: float, file: Path) -> None:
    """Write a plant's program as an FMU; LogError without a C compiler.

    The communication step must be a multiple of `sample_time` [s].
    """
    name = program.name
    sources = {
        f"{name}.h": c_header(program),
        f"{name}.c": c_source(program),
        f"{name}_fmi2.c": _wrapper(program, sample_time),
    }
    guid = hashlib.sha256("\0".join(sources.values()).encode()).hexdigest()
    description = _description(program, sample_time, guid, list(sources))
    sources = {key: text.replace("@GUID@", guid) for key, text in sources.items()}
    system = {"win32": "win", "darwin": "darwin"}.get(sys.platform, "linux")
    bits = platform.architecture()[0].removesuffix("bit")
    with tempfile.TemporaryDirectory() as folder:
        binary = shared_library(Path(folder), name, sources)
        entries = {
            "modelDescription.xml": description.encode(),
            **{f"sources/{key}": text.encode() for key, text in sources.items()},
            f"binaries/{system}{bits}/{binary.name}": binary.read_bytes(),
        }
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        for key, content in entries.items():
            archive.writestr(zipfile.ZipInfo(key, _YEAR), content, zipfile.ZIP_DEFLATED)


def _wrapper(program: Program, sample_time: float) -> str:
    """C of the standard's functions around the step."""
    template = files("dmptm_ctrl.data").joinpath("fmi2.c").read_text(encoding="ascii")
    inputs, outputs = len(program.inputs), len(program.outputs)
    given = ", ".join(f"m->value[{k}]" for k in range(inputs))
    found = ", ".join(f"&m->value[{inputs + k}]" for k in range(outputs))
    for key, text in {
        "@NAME@": program.name,
        "@INPUTS@": str(inputs),
        "@VALUES@": str(inputs + outputs),
        "@SAMPLE_TIME@": repr(sample_time),
        "@ARGUMENTS@": f"{given}, {found}",
    }.items():
        template = template.replace(key, text)
    return template


def _description(program: Program, sample_time: float, guid: str, sources: list[str]) -> str:
    root = Element(
        "fmiModelDescription",
        fmiVersion="2.0",
        modelName=program.name,
        guid=guid,
        description=" ".join(ascii_text(line) for line in program.notes),
        generationTool=f"dmptm-ctrl {dmptm_ctrl.__version__}",
    )
    kind = SubElement(
        root,
        "CoSimulation",
        modelIdentifier=program.name,
        canHandleVariableCommunicationStepSize="true",
    )
    listed = SubElement(kind, "SourceFiles")
    for key in sources:
        if key.endswith(".c"):
            SubElement(listed, "File", name=key)
    ports = [*program.inputs, *program.outputs]
    units = SubElement(root, "UnitDefinitions")
    for unit in dict.fromkeys(p.unit for p in ports):
        item = SubElement(units, "Unit", name=unit)
        if unit in _BASE:
            SubElement(item, "BaseUnit", {k: str(v) for k, v in _BASE[unit].items()})
    SubElement(root, "DefaultExperiment", startTime="0", stepSize=repr(sample_time))
    variables = SubElement(root, "ModelVariables")
    for k, port in enumerate(ports):
        _variable(variables, k, port, is_input=k < len(program.inputs))
    structure = SubElement(root, "ModelStructure")
    for part in ("Outputs", "InitialUnknowns"):
        group = SubElement(structure, part)
        for k in range(len(program.inputs), len(ports)):
            SubElement(group, "Unknown", index=str(k + 1))
    indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + tostring(root, encoding="unicode") + "\n"


def _variable(variables: Element, number: int, port: Port, *, is_input: bool) -> None:
    item = SubElement(
        variables,
        "ScalarVariable",
        name=port.name,
        valueReference=str(number),
        description=ascii_text(port.text),
        causality="input" if is_input else "output",
        variability="continuous",
    )
    SubElement(item, "Real", {"unit": port.unit, **({"start": "0"} if is_input else {})})
