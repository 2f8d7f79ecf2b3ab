"""The daemon behind the cab's screen: its status once a second and the operator's requests, on a thread of their own."""

from __future__ import annotations

import queue
import threading
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from yieldmon.cli._answers import loads_corrected, loads_without_ticket
from yieldmon.service.operator.control_client import ask
from yieldmon.service.operator.control_protocol import ControlError

Status = Mapping[str, Any]
_INTERVAL_S = 1.0
PATIENCE_S = 2.0
"""What a daemon may take for an answer before the screen says that there is none."""
SILENT_S = 5.0
"""A status is asked for once a second; after so long without one the last is no longer fresh."""


class DaemonLink:
    """Asks the daemon without holding up the screen.

    Parameters
    ----------
    path : Path
        The daemon's socket.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._requests: queue.SimpleQueue[Mapping[str, Any] | None] = queue.SimpleQueue()
        self._news: queue.SimpleQueue[Status | str | ControlError] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._run, name="status", daemon=True)

    def __enter__(self) -> DaemonLink:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._requests.put(None)

    def request(self, *requests: Mapping[str, Any]) -> None:
        """Have something done, in order; what became of each is among the news."""
        for request in requests:
            self._requests.put(request)

    def news(self) -> list[Status | str | ControlError]:
        """What came since the last call: a status, the error in place of one, a text for the operator."""
        found = []
        while not self._news.empty():
            found.append(self._news.get())
        return found

    def _run(self) -> None:
        request: Mapping[str, Any] | None = {"command": "status"}
        while request is not None:
            asked_status = request["command"] == "status"
            try:
                answer = ask(self.path, request)
            except ControlError as error:
                self._news.put(error if asked_status else str(error))
            else:
                self._news.put(answer if asked_status else _answered(request, answer))
            try:
                request = self._requests.get(timeout=_INTERVAL_S) if asked_status else {"command": "status"}
            except queue.Empty:
                request = {"command": "status"}


def aged(status: Status, silent_s: float) -> Status:
    """A status as it is to be shown when the daemon has not answered since, for silent_s seconds."""
    if silent_s < SILENT_S:
        return status
    return {**status, "stale": True, "age_s": status["age_s"] + silent_s}


def _answered(request: Mapping[str, Any], answer: Mapping[str, Any]) -> str:
    try:
        return said(request, answer)
    except (KeyError, TypeError, ValueError):
        # The thread must not end of it: the last status would pass for what is.
        return f"{request['command']}: done; the daemon has another version than this screen"


def said(request: Mapping[str, Any], answer: Mapping[str, Any]) -> str:
    """One sentence on what a request did, its masses in SI."""
    match request["command"]:
        case "load-start" | "load-stop" | "load-correct":
            return _said_of_load(request["command"], answer)
        case "ticket":
            change_pct = 100.0 * (answer["factor"] - 1.0)
            taken = f"ticket for load {answer['first_load']} taken: {change_pct:+.1f} % against what was measured"
            doubt = f"; {answer['question']}: is it right?" if answer.get("question") else ""
            if answer.get("sets_scale_pct") is not None:
                doubt += "; as the first, it alone sets the scale: weigh a second load"
            if answer.get("replaces"):
                doubt += "; it replaces the one before: of a load weighed in parts enter the sum"
            if without := answer.get("without_ticket"):
                doubt += f"; {loads_without_ticket(without)}"
            if crop := answer.get("waits_for_crop"):
                doubt += f"; it updates the parameters of {crop} once that is harvested again"
            return f"{taken}{doubt}" if answer["is_reference"] else f"{taken}; no reference: {answer['why_no_reference']}"
        case "zero":
            return "measuring the zero; keep the elevator running empty; undo with `yieldmon zero --undo`"
        case "sweep-start":
            return "the sweep begins as soon as flow and speed are steady"
    return "sweep aborted; the plate returns home"


def _said_of_load(command: str, answer: Mapping[str, Any]) -> str:
    if command == "load-correct":
        return f"{loads_corrected(answer)}; x, c and the former crop take it back"
    if command == "load-stop":
        return f"load {answer['load']} complete"
    crop = answer["crop"]
    not_known = "" if answer.get("crop_known", True) else ", an unknown crop: it starts with the previous crop's parameters"
    return f"load {answer['load']} started" + (f" of {crop}{not_known}" if crop else "")
