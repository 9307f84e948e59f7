"""Croissant 1.1: the dataset's description for machines (JSON-LD, https://mlcommons.org/croissant/1.1)."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pyarrow as pa

from generator import __version__
from generator.dataset.frame_columns import FRAME_SCHEMA
from generator.dataset.layout import CROISSANT, IMU, TABLES, DatasetSpec
from generator.files import write_bytes
from generator.frame.object_table import OBJECT_SCHEMA
from generator.frame.record import STAR_SCHEMA
from generator.imu.table import IMU_SCHEMA
from generator.scenario.file import Scenario
from generator.stored_files import StoredFile

LICENSE_URL = "https://creativecommons.org/licenses/by/4.0/"
RELEASED = "2026-11-21"
"""Release date of this version of skybench; a date for each dataset would make its bytes differ between runs."""
SCHEMAS = (FRAME_SCHEMA, STAR_SCHEMA, OBJECT_SCHEMA)
PROJECT_URL = "https://pypi.org/project/skybench/"

# The context that the Croissant 1.1 specification prescribes.
_CONTEXT: dict[str, Any] = {
    "@language": "en", "@vocab": "https://schema.org/", "arrayShape": "cr:arrayShape", "citeAs": "cr:citeAs",
    "column": "cr:column", "conformsTo": "dct:conformsTo", "containedIn": "cr:containedIn",
    "cr": "http://mlcommons.org/croissant/", "data": {"@id": "cr:data", "@type": "@json"},
    "dataType": {"@id": "cr:dataType", "@type": "@vocab"}, "dct": "http://purl.org/dc/terms/",
    "equivalentProperty": "cr:equivalentProperty", "examples": {"@id": "cr:examples", "@type": "@json"},
    "extract": "cr:extract", "field": "cr:field", "fileProperty": "cr:fileProperty", "fileObject": "cr:fileObject",
    "fileSet": "cr:fileSet", "format": "cr:format", "includes": "cr:includes", "isArray": "cr:isArray",
    "isLiveDataset": "cr:isLiveDataset", "jsonPath": "cr:jsonPath", "key": "cr:key", "md5": "cr:md5",
    "parentField": "cr:parentField", "path": "cr:path", "rai": "http://mlcommons.org/croissant/RAI/",
    "recordSet": "cr:recordSet", "references": "cr:references", "regex": "cr:regex", "repeated": "cr:repeated",
    "replace": "cr:replace", "samplingRate": "cr:samplingRate", "sc": "https://schema.org/", "separator": "cr:separator",
    "source": "cr:source", "subField": "cr:subField", "transform": "cr:transform",
}  # fmt: skip
_TYPES = {pa.bool_(): "sc:Boolean", pa.string(): "sc:Text"}


def croissant(scenario: Scenario, spec: DatasetSpec, files: list[StoredFile]) -> dict[str, Any]:
    """Describe a dataset: its files, and the columns of its tables."""
    schemas = dict(zip(TABLES, SCHEMAS, strict=True)) | ({IMU: IMU_SCHEMA} if scenario.has_imu else {})
    distribution: list[dict[str, Any]] = [
        {
            "@type": "cr:FileObject",
            "@id": file.path,
            "name": file.path,
            "contentUrl": file.path,
            "contentSize": f"{file.bytes} B",
            "encodingFormat": _media_type(file.path),
            "sha256": file.sha256,
        }
        for file in sorted(files, key=lambda file: file.path)
    ]
    distribution += [
        {
            "@type": "cr:FileSet",
            "@id": f"{table}-files",
            "name": f"{table}-files",
            "description": f"The parts of the table of {table}.",
            "encodingFormat": "application/x-parquet",
            "includes": f"{table}/{spec.split}/*.parquet",
        }
        for table in schemas
    ]
    return {
        "@context": _CONTEXT,
        "@type": "sc:Dataset",
        "conformsTo": "http://mlcommons.org/croissant/1.1",
        "name": scenario.name,
        "description": scenario.description or f"Synthetic night-sky frames of the scenario {scenario.name}.",
        "license": LICENSE_URL,
        "url": PROJECT_URL,
        "version": __version__,
        "datePublished": RELEASED,
        "creator": {"@type": "sc:Organization", "name": "skybench"},
        "citeAs": f"skybench {__version__}, scenario {scenario.name}, sha256 {scenario.sha256}",
        "isLiveDataset": False,
        "rai:dataCollection": "Rendered by skybench; every frame follows from the scenario file and its index.",
        "rai:dataLimitation": "Synthetic: see docs/physics.md of skybench for each model and its limits.",
        "distribution": distribution,
        "recordSet": [_record_set(table, schema) for table, schema in schemas.items()],
    }


def write_croissant(folder: Path, scenario: Scenario, spec: DatasetSpec, files: list[StoredFile]) -> None:
    """Write croissant.json atomically."""
    content = json.dumps(croissant(scenario, spec, files), indent=1, ensure_ascii=False)
    write_bytes(folder / CROISSANT, (content + "\n").encode())


def _record_set(table: str, schema: pa.Schema) -> dict[str, Any]:
    return {
        "@type": "cr:RecordSet",
        "@id": table,
        "name": table,
        "field": [
            {
                "@type": "cr:Field",
                "@id": f"{table}/{field.name}",
                "name": f"{table}/{field.name}",
                "description": _description(field),
                "dataType": _data_type(field.type),
                **({"isArray": True, "arrayShape": _array_shape(field.type)} if pa.types.is_nested(field.type) else {}),
                "source": {"fileSet": {"@id": f"{table}-files"}, "extract": {"column": field.name}},
            }
            for field in schema
        ],
    }


def _description(field: pa.Field) -> str:
    unit = (field.metadata or {}).get(b"unit", b"").decode()
    return f"{field.name} ({unit})" if unit else str(field.name)


def _data_type(kind: pa.DataType) -> str:
    if pa.types.is_nested(kind):
        kind = kind.value_type
    if pa.types.is_floating(kind):
        return "sc:Float"
    return "sc:Integer" if pa.types.is_integer(kind) else _TYPES[kind]


def _array_shape(kind: pa.DataType) -> str:
    return str(kind.list_size) if pa.types.is_fixed_size_list(kind) else "-1"


def _media_type(path: str) -> str:
    known = {
        ".tar": "application/x-tar",
        ".parquet": "application/x-parquet",
        ".json": "application/json",
        ".md": "text/markdown",
        ".yaml": "application/yaml",
        ".png": "image/png",
        ".svg": "image/svg+xml",
        ".csv": "text/csv",
        ".ply": "model/ply",
        ".obj": "model/obj",
        ".fits": "image/fits",
        ".exr": "image/x-exr",
    }
    return known.get(Path(path).suffix.lower(), "application/octet-stream")
