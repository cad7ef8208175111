"""Where is computed what a person asks for, and what must never make the robot wait?

Previews, graded sets and calibrations run in one child process of low priority, the *bench*.  It has its own
interpreter, so that it never holds the daemon's lock, and it is stopped while the cell takes a picture and works on it.

================  ===================================================================
``wire``          how daemon and child speak: JSON and blobs, on a pair of sockets
``child``         the child: one task after the other
``process``       the child as the daemon's thread sees it: start, ask, kill
``workbench``     the queue before it, as the event loop sees it
``tasks``         what can be asked for
================  ===================================================================
"""
