"""TOML, JSON and YAML files, read into pydantic schemas, and their errors as one sentence: the key, what is allowed."""

from __future__ import annotations

import difflib
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, TypeVar

import yaml
from pydantic import BaseModel, ConfigDict, ValidationError

from regrasp_opt.errors import PlanFileError, RegraspError, WorkcellError

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib


class Section(BaseModel):
    """A table of a file; unknown keys, NaN and infinity are errors."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


File = TypeVar("File", bound=Section)


class _Twice(Exception):
    """A key that a table of a file has twice."""


def _table(pairs: Sequence[tuple[str, Any]]) -> dict[str, Any]:
    """Return `pairs` as a table.

    Raises
    ------
    _Twice
        If two have the same key, of which one would be lost.
    """
    table = dict(pairs)
    if len(table) < len(pairs):
        keys = [key for key, _ in pairs]
        raise _Twice(next(key for key in keys if keys.count(key) > 1))
    return table


class _YamlLoader(getattr(yaml, "CSafeLoader", yaml.SafeLoader)):  # type: ignore[misc]
    """Reads plain data, and refuses tables that have a key twice."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        keys = [(key.value, key) for key, _ in node.value if isinstance(key, yaml.ScalarNode) and key.value != "<<"]
        _table(keys)
        table: dict[Any, Any] = super().construct_mapping(node, deep)
        return table


LONGEST_VALUE = 100
"""Characters of a wrong value that a message shows; longer ones are left out."""


def ascending(interval: tuple[float, float]) -> tuple[float, float]:
    """Return `interval` if its first number is below its second; for `pydantic.AfterValidator`."""
    if interval[0] >= interval[1]:
        raise ValueError("should be [low, high] with low < high")
    return interval


def read_toml(text: str, schema: type[File], where: str, error_type: type[RegraspError] = WorkcellError) -> File:
    """Return the TOML document `text` as `schema`, or raise an `error_type` that begins with `where` it comes from."""
    return validated(parse_toml(text, where, error_type), schema, where, error_type)


def parse_toml(text: str, where: str, error_type: type[RegraspError] = WorkcellError) -> dict[str, Any]:
    """Return the TOML document `text`, or raise an `error_type` that begins with `where` it comes from."""
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        raise error_type(f"{where} is not valid TOML: {error}") from error


def read_json(path: Path, what: str, error_type: type[RegraspError] = PlanFileError) -> Any:
    """Return the content of the JSON file `path`; `what` it should hold is named in errors.

    Raises
    ------
    PlanFileError
        Or another `error_type`: if it cannot be read, is not JSON, or has a key twice.
    """
    try:
        return json.loads(path.read_text(encoding="utf-8"), object_pairs_hook=_table)
    except _Twice as error:
        raise error_type(f"'{path}' has the key '{error}' twice in one place; keep the one that counts") from error
    except OSError as error:
        raise error_type(f"cannot read the {what} '{path}': {error.strerror or error}") from error
    except (ValueError, RecursionError) as error:
        raise error_type(f"'{path}' is not valid JSON; it may be cut short: save the {what} again") from error


def read_yaml(path: Path, error_type: type[RegraspError]) -> list[Any]:
    """Return the documents of the YAML file `path`, without empty ones; nothing but plain data is read.

    Raises
    ------
    RegraspError
        As an `error_type`: if it cannot be read, is not YAML, or has a key twice.
    """
    try:
        documents = yaml.load_all(path.read_text(encoding="utf-8"), _YamlLoader)
        return [document for document in documents if document is not None]
    except _Twice as error:
        raise error_type(f"'{path}' has the key '{error}' twice in one place; keep the one that counts") from error
    except OSError as error:
        raise error_type(f"cannot read '{path}': {error.strerror or error}") from error
    except (yaml.YAMLError, ValueError, TypeError, RecursionError) as error:
        raise error_type(f"'{path}' is not valid YAML; it may be cut short: write it again") from error


def validated(data: Any, schema: type[File], where: str, error_type: type[RegraspError]) -> File:
    """Return `data` as `schema`, or raise an `error_type` that begins with `where` and names the first wrong key."""
    try:
        return schema.model_validate(data)
    except ValidationError as error:
        raise error_type(f"{where}: {_described(error, schema)}") from error


def _described(error: ValidationError, schema: type[BaseModel]) -> str:
    """Return one problem of `error` as a clause: the key, what is wrong with it, what is allowed.

    An unknown key comes first: it is usually the misspelling behind a missing one.
    """
    problems: list[Any] = list(error.errors(include_url=False))
    problem = next((one for one in problems if one["type"] == "extra_forbidden"), problems[0])
    location = problem["loc"]
    parent = _schema_at(schema, location[:-1])
    key = ".".join(str(part) for part in location if "[" not in str(part))  # less the name of a type among several
    if problem["type"] == "missing" and parent is None:
        return f"key '{key}' is missing; add it"
    if parent is not None and problem["type"] in ("extra_forbidden", "missing"):
        keys = {field.alias or name: field.is_required() for name, field in parent.model_fields.items()}
        if problem["type"] == "missing":
            return f"key '{key}' is missing; needed here: {', '.join(name for name in keys if keys[name])}"
        close = difflib.get_close_matches(str(location[-1]), keys, n=len(keys), cutoff=0.4)
        return f"unknown key '{key}'; allowed: {', '.join([*close, *(name for name in keys if name not in close)])}"
    message = problem["msg"].removeprefix("Value error, ").removeprefix("Input ")
    given = problem["input"]
    shown = f", not {given!r}" if isinstance(given, (str, int, float, list, tuple)) else ""
    shown = shown if len(shown) < LONGEST_VALUE else ""
    return f"key '{key}': {message}{shown}" if key else message


def _schema_at(schema: type[BaseModel], location: tuple[int | str, ...]) -> type[BaseModel] | None:
    """Return the schema of the table at `location`; None where that is a value, such as an interval."""
    for part in location:
        if isinstance(part, str):
            inner = _schemas_in(schema.model_fields[part].annotation)
            if not inner:
                return None
            schema = inner[0]
    return schema


def _schemas_in(annotation: Any) -> list[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [schema for inner in getattr(annotation, "__args__", ()) for schema in _schemas_in(inner)]
