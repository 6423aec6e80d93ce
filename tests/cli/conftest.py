"""Helpers of the command-line tests: running a tool, making small images, reading what was written."""

import json
import os
import pathlib
import socket
import struct
import subprocess
import threading

import numpy as np
import OpenImageIO as oiio
import pytest

BIN = pathlib.Path(os.environ.get("SPECTEX_BIN", ""))


def tools():
    """Names of every spx* binary of the build."""
    return sorted(p.name for p in BIN.glob("spx*") if os.access(p, os.X_OK) and p.is_file())


class Outcome:
    """Exit code and output of a finished run; `code` is -N where signal N ended it."""

    def __init__(self, finished):
        self.code = finished.returncode
        self.stdout_bytes = finished.stdout
        self.stderr_bytes = finished.stderr
        self.stdout = finished.stdout.decode("utf-8", "replace")
        self.stderr = finished.stderr.decode("utf-8", "replace")

    def json(self):
        """Standard output as strict JSON: NaN and Infinity are refused."""

        def refuse(text):
            raise AssertionError(f"JSON holds {text}")

        return json.loads(self.stdout_bytes.decode("utf-8"), parse_constant=refuse)

    def __repr__(self):
        return f"exit {self.code}\nstdout:\n{self.stdout[-4000:]}\nstderr:\n{self.stderr[-4000:]}"


class ToolServer:
    """A tool with its libraries loaded, of which each run is a fork (tool_server.cpp)."""

    servers = {}

    @classmethod
    def of(cls, tool):
        """None where the build has no such library to preload."""
        library = os.environ.get("SPECTEX_TOOL_SERVER_LIBRARY")
        if library and tool not in cls.servers:
            cls.servers[tool] = cls(BIN / tool, library)
        return cls.servers.get(tool)

    def __init__(self, path, library):
        self.socket, theirs = socket.socketpair()
        with theirs:
            fd = theirs.fileno()
            self.process = subprocess.Popen(
                [path], stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, pass_fds=[fd],
                env={**os.environ, "LD_PRELOAD": library, "SPECTEX_TOOL_SERVER": str(fd)})

    def number(self):
        data = self.socket.recv(4, socket.MSG_WAITALL)
        assert len(data) == 4, f"the server of {self.process.args[0]} has ended: {self.process.wait()}"
        return struct.unpack("=i", data)[0]

    def run(self, command, timeout, cwd):
        """As subprocess.run with captured output and nothing to read."""
        words = [os.path.abspath(cwd or "."), str(len(command)), *command, *[f"{k}={v}" for k, v in os.environ.items()]]
        request = b"".join(os.fsencode(w) + b"\0" for w in words)
        pipes = [os.pipe(), os.pipe()]
        with open(os.devnull, "rb") as nothing:
            socket.send_fds(self.socket, [struct.pack("=I", len(request))], [nothing.fileno(), pipes[0][1], pipes[1][1]])
        self.socket.sendall(request)
        for _, write_end in pipes:
            os.close(write_end)
        said = [b"", b""]

        def listen(i):
            with open(pipes[i][0], "rb") as read_end:
                said[i] = read_end.read()

        listeners = [threading.Thread(target=listen, args=(i,)) for i in range(2)]
        for listener in listeners:
            listener.start()
        pid = self.number()
        self.socket.settimeout(timeout)
        try:
            status = self.number()
        except TimeoutError:
            os.kill(pid, 9)
            self.socket.settimeout(None)
            self.number()
            raise subprocess.TimeoutExpired(command, timeout) from None
        finally:
            self.socket.settimeout(None)
        for listener in listeners:
            listener.join()
        return subprocess.CompletedProcess(command, os.waitstatus_to_exitcode(status), *said)


def run_tool(tool, *args, input=None, timeout=120, env=None, cwd=None, check=None):
    """Runs a tool; `env` is added to the environment, `check` is the exit code expected."""
    command = [str(BIN / tool), *[a if isinstance(a, bytes) else str(a) for a in args]]
    # Libraries may look at the environment while they are loaded.
    server = ToolServer.of(tool) if input is None and not env else None
    if server:
        finished = server.run(command, timeout, cwd)
    else:
        finished = subprocess.run(
            command, input=input, stdin=subprocess.DEVNULL if input is None else None,
            stdout=subprocess.PIPE, stderr=subprocess.PIPE, timeout=timeout, cwd=cwd,
            env={**os.environ, **(env or {})})
    outcome = Outcome(finished)
    if check is not None:
        assert outcome.code == check, outcome
    return outcome


def write_image(path, pixels, channels=None, attributes=None, compression=None):
    """Writes [height][width][channels] of uint8, uint16, float16 or float32 as the suffix says."""
    pixels = np.ascontiguousarray(pixels)
    if pixels.ndim == 2:
        pixels = pixels[:, :, None]
    height, width, count = pixels.shape
    kind = {"uint8": "uint8", "uint16": "uint16", "float16": "half", "float32": "float"}[pixels.dtype.name]
    spec = oiio.ImageSpec(width, height, count, kind)
    if channels:
        spec.channelnames = channels
    if compression:
        spec.attribute("compression", compression)
    for name, value in (attributes or {}).items():
        if isinstance(value, (list, tuple)):
            spec.attribute(name, f"float[{len(value)}]", [float(v) for v in value])
        else:
            spec.attribute(name, value)
    output = oiio.ImageOutput.create(str(path))
    assert output, oiio.geterror()
    assert output.open(str(path), spec), output.geterror()
    assert output.write_image(pixels), output.geterror()
    assert output.close()
    return pathlib.Path(path)


def read_image(path, kind="float"):
    """Pixels as [height][width][channels] and the channel names, by OpenImageIO, first part."""
    source = oiio.ImageInput.open(str(path))
    assert source, oiio.geterror()
    spec = source.spec()
    pixels = source.read_image(kind)
    names = list(spec.channelnames)
    source.close()
    return np.asarray(pixels), names


def write_spectral(path, spectra, wavelengths_nm, prefix="T", attributes=None):
    """Writes [height][width][bands] float32 in the layout of Fichet, Pacanowski and Wilkie 2021."""
    names = [f"{prefix}.{w:.6f}nm".replace(".", ",").replace(f"{prefix},", f"{prefix}.", 1) for w in wavelengths_nm]
    merged = {"spectralLayoutVersion": "1.0", **(attributes or {})}
    return write_image(path, np.asarray(spectra, dtype=np.float32), names, merged)


@pytest.fixture
def run():
    return run_tool


@pytest.fixture
def gradient():
    """8-bit RGB, 16 wide and 8 high, every value different enough to be told apart."""
    y, x = np.mgrid[0:8, 0:16]
    return np.stack([x * 17, y * 36, (x + y) * 11], axis=2).astype(np.uint8)


@pytest.fixture
def png(tmp_path, gradient):
    return write_image(tmp_path / "gradient.png", gradient)
