"""Of which types are the arguments of the controller's own functions?

As the prototypes of $OPERATE and the manuals' examples give them; ``*`` stands for what may be of any type.
"""

__all__ = ["SIGNATURES"]

_TEXTS = "CHAR[],CHAR[]"

SIGNATURES: dict[str, str] = {
    **dict.fromkeys(("ABS", "SQRT", "SIN", "COS", "TAN", "ACOS", "TIMER_LIMIT"), "REAL"),
    "ATAN2": "REAL,REAL",
    "FRAND": "REAL,REAL",
    "STRLEN": "CHAR[]",
    "STRDECLLEN": "CHAR[]",
    "STRCLEAR": "CHAR[]",
    "STRADD": _TEXTS,
    "STRCOPY": _TEXTS,
    "STRCOMP": f"{_TEXTS},CASE_SENSE_T",
    "STRFIND": f"INT,{_TEXTS},CASE_SENSE_T",
    "STRTOINT": "CHAR[],INT:OUT",
    "STRTOREAL": "CHAR[],REAL:OUT",
    "STRTOBOOL": "CHAR[],BOOL:OUT",
    "VARSTATE": "CHAR[]",
    "BAS": "BAS_COMMAND,REAL",
    "INVERSE": "E6POS,E6AXIS,INT:OUT",
    "FORWARD": "E6AXIS,INT:OUT",
    "INV_POS": "E6POS",
    "SET_KRLMSG": "EKRLMSGTYPE,KRLMSG_T,KRLMSGPAR_T[],KRLMSGOPT_T",
    "SET_KRLDLG": "KRLMSG_T,KRLMSGPAR_T[],KRLMSGDLGSK_T[],KRLMSGOPT_T",
    "EXISTS_KRLMSG": "INT",
    "EXISTS_KRLDLG": "INT,INT:OUT",
    "CLEAR_KRLMSG": "INT",
    "MSGNOTIFY": "CHAR[],CHAR[],INT,CHAR[],INT,KRLMSGOPT_T",
    "MSGQUIT": "CHAR[],CHAR[],INT,CHAR[],INT,KRLMSGOPT_T",
    "MSGSTATE": "INT:OUT,CHAR[],CHAR[],INT,CHAR[],INT,KRLMSGOPT_T",
    "MSGDIALOG": "INT:OUT,CHAR[],CHAR[],CHAR[]" + ",CHAR[]" * 7 + ",BOOL,INT,KRLMSGOPT_T",
    "PULSE": "*,BOOL,REAL",
    "IS_KEY_PRESSED": "INT",
    **dict.fromkeys(("EKI_INIT", "EKI_OPEN", "EKI_CLOSE", "EKI_CLEAR", "EKI_LOCK", "EKI_UNLOCK"), "CHAR[]"),
    "EKI_CHECKBUFFER": _TEXTS,
    "EKI_CLEARBUFFER": _TEXTS,
    "EKI_SEND": f"{_TEXTS},INT",
    "EKI_CHECK": "EKI_STATUS,EKRLMSGTYPE,CHAR[]",
    "EKI_SETSTRING": f"{_TEXTS},CHAR[]",
    "EKI_GETSTRING": f"{_TEXTS},CHAR[]",
    **{f"EKI_SET{kind}": f"{_TEXTS},{kind}" for kind in ("INT", "REAL", "BOOL", "FRAME")},
    **{f"EKI_GET{kind}": f"{_TEXTS},{kind}:OUT" for kind in ("INT", "REAL", "BOOL", "FRAME")},
    **{f"EKI_GET{kind}ARRAY": f"{_TEXTS},{kind}[]:OUT" for kind in ("INT", "REAL", "BOOL", "FRAME")},
}
