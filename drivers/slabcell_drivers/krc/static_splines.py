"""What may stand in a spline block?  Segments, triggers and conditions of the path, and nothing else."""

from collections.abc import Iterator

from slabcell_drivers.krc.syntax import Declaration, Motion, Node, Spline, SplineCondition, Trigger

__all__ = ["spline_problems"]

_SEGMENTS = {
    "SPLINE": frozenset({"SPL", "SLIN", "SCIRC", "SPL_REL", "SLIN_REL", "SCIRC_REL"}),
    "PTP_SPLINE": frozenset({"SPTP", "SPTP_REL"}),
}


def spline_problems(spline: Spline) -> Iterator[tuple[Node, str, str]]:
    """Yield what a block cannot hold: the statement, a code and a message."""
    time_blocks: list[str] = []
    for statement in spline.body:
        match statement:
            case Motion(kind=kind):
                if kind not in _SEGMENTS[spline.kind]:
                    code = "ptp-spline" if spline.kind == "PTP_SPLINE" else "spline"
                    yield statement, code, f"{kind} cannot stand in a {spline.kind} block"
                elif statement.approximation:
                    text = f"{' '.join(statement.approximation)}: segments of a block are passed anyway"
                    yield statement, "spline-approximation", text
            case Trigger(kind="DISTANCE"):
                yield statement, "spline-trigger", "a spline block takes TRIGGER WHEN PATH, not DISTANCE"
            case SplineCondition(kind="CONST_VEL") if spline.kind == "PTP_SPLINE":
                yield statement, "ptp-spline", "CONST_VEL cannot stand in a PTP_SPLINE block"
            case SplineCondition(kind="TIME_BLOCK", verb=verb):
                time_blocks.append(verb)
            case Trigger() | SplineCondition() | Declaration():
                pass
            case _:
                yield statement, "spline", f"this statement cannot stand in a {spline.kind} block"
    if time_blocks and (time_blocks[0], time_blocks[-1]) != ("START", "END"):
        yield spline, "time-block", "TIME_BLOCK begins with START, goes on with PART, and closes with END"
