"""The control API: HTTP and server-sent events on a Unix socket, for the command line, the HMI and other programs."""
