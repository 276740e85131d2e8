"""TOML files read into pydantic schemas, and their errors as one sentence that names the key and what is allowed."""

from __future__ import annotations

import difflib
import sys
from typing import Any, TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError

from regrasp_opt.errors import WorkcellError

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib


class Section(BaseModel):
    """A table of a file; unknown keys are errors."""

    model_config = ConfigDict(extra="forbid", frozen=True)


File = TypeVar("File", bound=Section)


def ascending(interval: tuple[float, float]) -> tuple[float, float]:
    """Return `interval` if its first number is below its second; for `pydantic.AfterValidator`."""
    if interval[0] >= interval[1]:
        raise ValueError("should be [low, high] with low < high")
    return interval


def read_toml(text: str, schema: type[File], where: str) -> File:
    """Return the TOML document `text` as `schema`; `where` it stands begins every message.

    Raises
    ------
    WorkcellError
        If it is not valid TOML or does not fit the schema.
    """
    try:
        data = tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        raise WorkcellError(f"{where} is not valid TOML: {error}") from error
    try:
        return schema.model_validate(data)
    except ValidationError as error:
        raise WorkcellError(f"{where}: {_described(error, schema)}") from error


def _described(error: ValidationError, schema: type[BaseModel]) -> str:
    """Return one problem of `error` as a clause: the key, what is wrong with it, what is allowed.

    An unknown key comes first: it is usually the misspelling behind a missing one.
    """
    problems: list[Any] = list(error.errors(include_url=False))
    problem = next((one for one in problems if one["type"] == "extra_forbidden"), problems[0])
    location = problem["loc"]
    parent = _schema_at(schema, location[:-1])
    key = ".".join(str(part) for part in location)
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
