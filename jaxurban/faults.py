"""What pydantic found wrong with settings, as one sentence."""

from typing import Any, get_args

from pydantic import BaseModel, ValidationError

from jaxurban.errors import nearest_name


def sentence_of(error: ValidationError, model: type[BaseModel]) -> str:
    """Return the first fault of a validation of ``model`` as one sentence that names the setting."""
    fault = error.errors()[0]
    is_unknown = fault["type"] == "extra_forbidden"
    *parents, last = fault["loc"] or ("",)
    names = []
    for part in parents:
        inner = model.model_fields.get(str(part))
        if inner is not None:
            model = _model_in(inner.annotation) or model
        if inner is not None or isinstance(part, int):  # the rest are pydantic's names for the types of a union
            names.append(str(part))
    if is_unknown or isinstance(last, int) or last in model.model_fields:
        names.append(str(last))
    where = ".".join(names)
    if is_unknown:
        valid = list(model.model_fields)
        hint = nearest_name(str(last), valid) or f"; the valid ones are {', '.join(valid)}"
        return f"unknown {'key' if parents else 'section'} {where!r}{hint}"
    if fault["type"] == "missing":
        return f"{where!r} is required and missing"
    if fault["type"] == "model_type":
        return f"{where}: must be a table of settings, got {fault['input']!r}"
    message = fault["msg"].removeprefix("Value error, ")
    given = "" if fault["type"] == "value_error" else f", got {fault['input']!r}"
    prefix = f"{where}: " if where else ""
    return f"{prefix}{message[0].lower() + message[1:]}{given}"


def _model_in(annotation: Any) -> type[BaseModel] | None:
    """Return the model that an annotation names, on its own or in a list or union; None if it names none."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    return next(filter(None, map(_model_in, get_args(annotation))), None)
