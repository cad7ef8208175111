"""What is under way beside the cell, and what came of it?"""

from __future__ import annotations

from typing import Any, Literal

from pydantic import Field

from slabcell.service.api.context import ApiContext
from slabcell.service.api.documents import Document, Done
from slabcell.service.api.endpoint import Call, Endpoint
from slabcell.service.api.problems import ProblemError
from slabcell.service.background import BackgroundTask

__all__ = ["ENDPOINTS", "TaskDocument", "task_view"]


class TaskDocument(Document):
    """A piece of work that takes longer than a request may."""

    schema_: Literal["slabcell.task/1"] = Field(default="slabcell.task/1", alias="schema")
    task: str
    kind: str = Field(description="what sort of work")
    title: str
    state: Literal["running", "done", "failed", "cancelled"]
    done: int = Field(description="steps that are done")
    total: int = Field(description="steps in all; 0 if that is not known")
    doing: str = Field(description="what it is at, in words")
    problem: str = Field(description="why it failed; empty if it did not")
    number: int = Field(description="its number in the error catalogue; 0 if there is none")
    duration_s: float
    result: dict[str, Any] | None = Field(description="what came of it, when it is done")


class TasksDocument(Document):
    """What runs, and the last that ended; the newest first."""

    schema_: Literal["slabcell.tasks/1"] = Field(default="slabcell.tasks/1", alias="schema")
    tasks: list[TaskDocument]


def task_view(task: BackgroundTask, *, result: bool = True) -> TaskDocument:
    """Return a piece of work as it is sent; without its result for lists and events."""
    return TaskDocument(
        task=task.name,
        kind=task.kind,
        title=task.title,
        state=task.state.value,  # pyright: ignore[reportArgumentType]  (the model checks it)
        done=task.done,
        total=task.total,
        doing=task.doing,
        problem=task.problem,
        number=task.number,
        duration_s=round(task.duration_s, 3),
        result=task.result if result else None,
    )


def _found(call: Call[ApiContext]) -> BackgroundTask:
    task = call.context.studio.background.get(call.text("task"))
    if task is None:
        raise ProblemError(404, f"there is no task {call.text('task')!r:.40}, or not any more")
    return task


async def _list(call: Call[ApiContext]) -> TasksDocument:
    return TasksDocument(tasks=[task_view(task, result=False) for task in call.context.studio.background.tasks])


async def _one(call: Call[ApiContext]) -> TaskDocument:
    return task_view(_found(call))


async def _cancel(call: Call[ApiContext]) -> Done:
    task = _found(call)
    await call.context.studio.background.cancel(task)
    return Done(detail=f"task {task.name} is {task.state}")


_TAG = "tasks"
ENDPOINTS = (
    Endpoint("GET", "/v1/tasks", "What runs beside the cell, and the last that ended", _list, TasksDocument, _TAG),
    Endpoint("GET", "/v1/tasks/{task}", "One of them, with what came of it", _one, TaskDocument, _TAG, problems=(404,)),
    Endpoint("POST", "/v1/tasks/{task}/cancel", "End it before its time", _cancel, Done, _TAG, problems=(404,)),
)
