"""What do KRL's functions around motion do?  BAS, the helpers of inline forms, and the kinematics."""

from slabcell_drivers.krc.builtin_table import Builtin
from slabcell_drivers.krc.cells import Place
from slabcell_drivers.krc.host import Host
from slabcell_drivers.krc.messages import KrlError, RunMessage
from slabcell_drivers.krc.motion_planner import AXIS_FIELDS
from slabcell_drivers.krc.operators import frame_of, set_frame
from slabcell_drivers.krc.values import ArrayValue, EnumConstant, StructType, StructValue, Value, text_of
from slabcell_drivers.robot.arm import ArmError, Axes
from slabcell_drivers.robot.frame import Frame

__all__ = ["MOTION_BUILTINS"]

_EXTERNAL_AXES = ("E1", "E2", "E3", "E4", "E5", "E6")


def _struct(host: Host, name: str) -> StructType:
    type_ = host.project.find_type(name, None)
    assert isinstance(type_, StructType)  # noqa: S101  # predefined.dat declares it
    return type_


# --- BAS -----------------------------------------------------------------------------------------------------------


def _bas(host: Host, command: Value, number: Value = None) -> None:
    if not isinstance(command, EnumConstant):
        raise KrlError(RunMessage.TYPE, f"BAS: {text_of(command)} is no command")
    value = 0.0 if number is None else float(number)
    match command.name:
        case "INITMOV":
            _initialize(host)
        case "ACC_PTP" | "VEL_PTP":
            _percent(host, "$VEL_AXIS" if command.name == "VEL_PTP" else "$ACC_AXIS", value, command.name)
        case "VEL_CP":
            _path_speed(host, value)
        case "ACC_CP":
            _path_acceleration(host, value)
        case "TOOL":
            _set_tool(host, int(value))
        case "BASE" | "EX_BASE":
            _set_base(host, int(value))
        case "PTP_PARAMS":
            _bas(host, EnumConstant("PTP_DAT"))
            _bas(host, EnumConstant("FRAMES"))
            _percent(host, "$VEL_AXIS", value, command.name)
        case "CP_PARAMS":
            _bas(host, EnumConstant("CP_DAT"))
            _bas(host, EnumConstant("FRAMES"))
            _path_speed(host, value)
        case "PTP_DAT":
            data = host.data_or_none("PDAT_ACT")
            if isinstance(data, StructValue):
                _percent(host, "$VEL_AXIS", float(data.get("VEL") or 100.0), command.name)
                _percent(host, "$ACC_AXIS", float(data.get("ACC") or 100.0), command.name)
                mode, distance = data.get("APO_MODE"), float(data.get("APO_DIST") or 0.0)
                if isinstance(mode, EnumConstant) and mode.name == "CDIS":
                    host.system.read("$APO").set("CDIS", distance)
                else:
                    host.system.read("$APO").set("CPTP", min(100.0, distance))
        case "CP_DAT":
            data = host.data_or_none("LDAT_ACT")
            if isinstance(data, StructValue):
                _path_speed(host, float(data.get("VEL") or _default(host, "DEF_VEL_CP")))
                _path_acceleration(host, float(data.get("ACC") or 100.0))
                host.system.read("$APO").set("CDIS", float(data.get("APO_DIST") or 0.0))
        case "FRAMES":
            data = host.data_or_none("FDAT_ACT")
            if isinstance(data, StructValue):
                _set_tool(host, int(data.get("TOOL_NO") or 0))
                _set_base(host, int(data.get("BASE_NO") or 0))
        case _:
            pass  # ACC_GLUE, OUT_SYNC, OUT_ASYNC, GROUP: nothing of this cell


def _default(host: Host, name: str) -> float:
    value = host.data_or_none(name)
    return float(value) if isinstance(value, int | float) else 100.0


def _initialize(host: Host) -> None:
    _percent(host, "$VEL_AXIS", _default(host, "DEF_VEL_PTP"), "INITMOV")
    _percent(host, "$ACC_AXIS", _default(host, "DEF_ACC_PTP"), "INITMOV")
    speeds, accelerations, apo = (host.system.read(name) for name in ("$VEL", "$ACC", "$APO"))
    speeds.set("CP", _default(host, "DEF_VEL_CP"))
    accelerations.set("CP", _default(host, "DEF_ACC_CP"))
    for member in ("ORI1", "ORI2"):
        speeds.set(member, _default(host, "DEF_VEL_ORI1"))
        accelerations.set(member, _default(host, "DEF_ACC_ORI1"))
    for member in ("CPTP", "CDIS", "CORI", "CVEL"):
        apo.set(member, _default(host, f"DEF_APO_{member}"))
    host.system.write("$ADVANCE", 3)
    tools = host.data_or_none("TOOL_DATA")
    first = tools.get((1,)) if isinstance(tools, ArrayValue) else None
    _set_tool(host, 1 if isinstance(first, StructValue) and first.fields else 0)
    _set_base(host, 0)


def _path_speed(host: Host, metres_per_second: float) -> None:
    if metres_per_second <= 0.0:
        raise KrlError(RunMessage.RANGE, f"BAS(#VEL_CP,{metres_per_second:g}): the speed must be above 0 m/s")
    host.system.read("$VEL").set("CP", min(metres_per_second, _default(host, "DEF_VEL_CP")))


def _path_acceleration(host: Host, percent: float) -> None:
    if percent <= 0.0:
        raise KrlError(RunMessage.RANGE, f"BAS(#ACC_CP,{percent:g}): the acceleration must be above 0 %")
    share = min(percent, 100.0) / 100.0
    accelerations = host.system.read("$ACC")
    accelerations.set("CP", _default(host, "DEF_ACC_CP") * share)
    for member in ("ORI1", "ORI2"):
        accelerations.set(member, _default(host, "DEF_ACC_ORI1") * share)


def _percent(host: Host, name: str, value: float, command: str) -> None:
    if not 0.0 < value <= 100.0:
        raise KrlError(RunMessage.RANGE, f"BAS(#{command},{value:g}): the value is not in 1 to 100 %")
    array = host.system.read(name)
    for axis in range(1, 7):
        array.set((axis,), value)


def _numbered(host: Host, array_name: str, number: int) -> Value:
    array = host.data_or_none(array_name)
    if not isinstance(array, ArrayValue):
        raise KrlError(RunMessage.UNDECLARED, f"{array_name} is not declared")
    try:
        return array.get((number,))
    except KrlError as error:
        raise KrlError(error.number, f"{array_name}[{number}]: {error.detail}") from None


def _set_tool(host: Host, number: int) -> None:
    frame = set_frame(StructValue(_struct(host, "FRAME"), {}), Frame())
    if number > 0:
        frame = _numbered(host, "TOOL_DATA", number)
        if not frame.fields:
            raise KrlError(RunMessage.VALUE_INVALID, f"TOOL_DATA[{number}] value invalid")
        load = _numbered(host, "LOAD_DATA", number)
        if isinstance(load, StructValue) and load.fields:
            host.system.write("$LOAD", load)
    host.system.write("$TOOL", frame)
    host.system.write("$ACT_TOOL", number)


def _set_base(host: Host, number: int) -> None:
    frame = set_frame(StructValue(_struct(host, "FRAME"), {}), Frame())
    if number > 0:
        frame = _numbered(host, "BASE_DATA", number)
        if not frame.fields:
            raise KrlError(RunMessage.VALUE_INVALID, f"BASE_DATA[{number}] value invalid")
    host.system.write("$BASE", frame)
    host.system.write("$ACT_BASE", number)


# --- helpers of inline forms ---------------------------------------------------------------------------------------


def _tool_of_form(host: Host, data: Value, *_: Value) -> Value:
    number = int(data.get("TOOL_NO") or 0) if isinstance(data, StructValue) else int(data or 0)
    host.system.write("$ACT_TOOL", max(0, number))
    if number <= 0:
        return set_frame(StructValue(_struct(host, "FRAME"), {}), Frame())
    return _numbered(host, "TOOL_DATA", number)


def _base_of_form(host: Host, number: Value, *_: Value) -> Value:
    if isinstance(number, StructValue):
        number = number.get("BASE_NO")
    host.system.write("$ACT_BASE", max(0, int(number or 0)))
    if int(number or 0) <= 0:
        return set_frame(StructValue(_struct(host, "FRAME"), {}), Frame())
    return _numbered(host, "BASE_DATA", int(number))


def _load_of_form(host: Host, number: Value, *_: Value) -> Value:
    if int(number or 0) > 0:
        load = _numbered(host, "LOAD_DATA", int(number))
        if isinstance(load, StructValue) and load.fields:
            return load
    null: dict[str, Value] = {"M": -1.0}
    return StructValue(_struct(host, "LOAD"), null)


def _speed_of_form(_: Host, value: Value, *__: Value) -> float:
    return float(value)


def _acceleration_of_form(host: Host, value: Value = None, *_: Value) -> Value:
    """$ACC=SACC_CP(data): path acceleration in per cent of the default."""
    percent = float(value.get("ACC") or 100.0) if isinstance(value, StructValue) else 100.0
    turning = _default(host, "DEF_ACC_ORI1")
    path = _default(host, "DEF_ACC_CP") * percent / 100.0
    return StructValue(_struct(host, "CP"), {"CP": path, "ORI1": turning, "ORI2": turning})


def _axis_acceleration_of_form(_: Host, value: Value = None, *__: Value) -> float:
    percent = value.get("ACC") if isinstance(value, StructValue) else value
    return float(percent or 100.0)


def _path_speed_of_form(host: Host, value: Value, *_: Value) -> Value:
    """$VEL=SVEL_CP(speed,,data): the orientation turns at its default speed."""
    turning = _default(host, "DEF_VEL_ORI1")
    return StructValue(_struct(host, "CP"), {"CP": float(value), "ORI1": turning, "ORI2": turning})


def _approximation_of_form(host: Host, data: Value = None, *_: Value) -> Value:
    """$APO=SAPO(data) and its kin."""
    distance = float(data.get("APO_DIST") or 0.0) if isinstance(data, StructValue) else 0.0
    return StructValue(
        _struct(host, "APO"), {"CPTP": min(100.0, distance), "CDIS": distance, "CORI": 100.0, "CVEL": 100.0}
    )


def _jerk_of_form(_: Host, *__: Value) -> float:
    return 50.0


def _ipo_of_form(_: Host, *__: Value) -> EnumConstant:
    return EnumConstant("BASE")


def _orientation_of_form(_: Host, data: Value = None, *__: Value) -> EnumConstant:
    found = data.get("ORI_TYP") if isinstance(data, StructValue) else None
    return found if isinstance(found, EnumConstant) else EnumConstant("VAR")


def _circle_of_form(_: Host, data: Value = None, *__: Value) -> EnumConstant:
    found = data.get("CIRC_TYP") if isinstance(data, StructValue) else None
    return found if isinstance(found, EnumConstant) else EnumConstant("BASE")


def _circle_mode_of_form(host: Host, data: Value = None, *__: Value) -> StructValue:
    found = data.get("CB") if isinstance(data, StructValue) else None
    return found if isinstance(found, StructValue) else StructValue(_struct(host, "CIRC_MODE"), {})


def _collision_of_form(_: Host, *__: Value) -> int:
    """Return the tolerance of the first axis: collisions are not monitored here."""
    return 0


def _nothing(_: Host, *__: Value) -> None:
    return None


# --- kinematics ----------------------------------------------------------------------------------------------------


def _axes_value(host: Host, axes: Axes) -> StructValue:
    fields: dict[str, Value] = dict(zip(AXIS_FIELDS, axes, strict=True))
    value = StructValue(_struct(host, "E6AXIS"), fields)
    fields |= dict.fromkeys(_EXTERNAL_AXES, 0.0)
    return value


def _axes_of(value: Value, name: str) -> Axes:
    if not isinstance(value, StructValue):
        raise KrlError(RunMessage.TYPE, f"{name}: {text_of(value)} is no E6AXIS")
    try:
        a = [float(value.fields[field]) for field in AXIS_FIELDS]
    except (KeyError, TypeError):
        raise KrlError(RunMessage.VALUE_INVALID, f"{name}: {text_of(value)} lacks an axis") from None
    return (a[0], a[1], a[2], a[3], a[4], a[5])


def _inverse(host: Host, position: Value, start: Value, error: Place | None = None) -> Value:
    if not isinstance(position, StructValue) or not position.fields:
        raise KrlError(RunMessage.VALUE_INVALID, f"INVERSE: {text_of(position)} is no position")
    near = _axes_of(start, "INVERSE")
    planner = host.motion.planner
    try:
        axes = planner.axes_of(position, near, planner.tool_or_null, planner.base_or_null)
    except ArmError:
        if error is None:
            raise KrlError(RunMessage.RANGE, f"INVERSE: {text_of(position)} cannot be reached") from None
        error.set(1)
        return _axes_value(host, near)
    if error is not None:
        error.set(0)
    return _axes_value(host, axes)


def _forward(host: Host, axes: Value, error: Place | None = None) -> Value:
    angles = _axes_of(axes, "FORWARD")
    planner = host.motion.planner
    try:
        planner.arm.check_limits(angles)
    except ArmError:
        if error is not None:
            error.set(1)
    else:
        if error is not None:
            error.set(0)
    flange = planner.arm.forward(angles)
    value = set_frame(
        StructValue(_struct(host, "E6POS"), {}), planner.base_or_null.inverse() @ flange @ planner.tool_or_null
    )
    status, turn = planner.arm.status_turn(angles)
    value.fields |= {"S": status, "T": turn, **dict.fromkeys(_EXTERNAL_AXES, 0.0)}
    return value


def _inverse_position(host: Host, position: Value) -> Value:
    frame = frame_of(position).inverse()
    type_ = position.type if isinstance(position, StructValue) and position.type is not None else _struct(host, "FRAME")
    return set_frame(StructValue(type_, {}), frame)


_WITHOUT_EFFECT = (
    "SECURE_HOME",
    "SPTP_CHECK",
    "SET_CD_PARAMS",
    "USE_CD_PARAMS",
    "SET_TQ_VALUES",
    "BASISTECH_PLC_INIT",
    "BASISTECH_PLC_LOOP",
)
"""What inline forms and sps.sub call of the controller's own, and what has nothing to do here."""

MOTION_BUILTINS: dict[str, Builtin] = {
    "BAS": Builtin(_bas, 1, 2),
    "INVERSE": Builtin(_inverse, 2, 3, frozenset({2}), result="E6AXIS"),
    "FORWARD": Builtin(_forward, 1, 2, frozenset({1}), result="E6POS"),
    "INV_POS": Builtin(_inverse_position, 1, 1),
    "STOOL2": Builtin(_tool_of_form, 1, 3, result="FRAME"),
    "STOOL": Builtin(_tool_of_form, 1, 3, result="FRAME"),
    "SBASE": Builtin(_base_of_form, 1, 3, result="FRAME"),
    "SLOAD": Builtin(_load_of_form, 1, 3, result="LOAD"),
    "SVEL_JOINT": Builtin(_speed_of_form, 1, 3, result="REAL"),
    "SACC_JOINT": Builtin(_axis_acceleration_of_form, 0, 3, result="REAL"),
    "SVEL_CP": Builtin(_path_speed_of_form, 1, 3, result="CP"),
    "SACC_CP": Builtin(_acceleration_of_form, 0, 3, result="CP"),
    "SAPO": Builtin(_approximation_of_form, 0, 3, result="APO"),
    "SAPO_PTP": Builtin(_approximation_of_form, 0, 3, result="APO"),
    "SGEAR_JERK": Builtin(_jerk_of_form, 0, 3, result="REAL"),
    "SJERK": Builtin(_jerk_of_form, 0, 3),
    "SIPO_MODE": Builtin(_ipo_of_form, 0, 3),
    "SORI_TYP": Builtin(_orientation_of_form, 0, 3),
    "SCIRC_TYP": Builtin(_circle_of_form, 0, 3),
    "SCIRC_M": Builtin(_circle_mode_of_form, 0, 3),
    "USE_CM_PRO_VALUES": Builtin(_collision_of_form, 0, 1, result="INT"),
    **{name: Builtin(_nothing, 0, 8) for name in _WITHOUT_EFFECT},
    "IR_STOPM": Builtin(_nothing, 0, 0),
}
