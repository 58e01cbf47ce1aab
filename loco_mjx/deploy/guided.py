"""A policy that sees, over the whole-body controller: it says how fast to walk and turn, the controller walks."""

from __future__ import annotations

import queue
from collections.abc import Callable
from typing import Any

import numpy as np

from loco_mjx.controllers import ticks
from loco_mjx.deploy.folder import Manifest
from loco_mjx.deploy.observer import Observer
from loco_mjx.deploy.robot import DrivenRobot, Frame, Sensors
from loco_mjx.deploy.runner import Policy
from loco_mjx.deploy.safety import Cause, Stop
from loco_mjx.deploy.walker import Walker
from loco_mjx.deploy.worker import Overdue, Worker
from loco_mjx.errors import UserError
from loco_mjx.robots import Robot

OF_POLICY = "policy"  # whose deadlines are its own


class Guided(Walker):
    """Runs one policy of controller `mpc` on one robot: 20 decisions a second over 200 ticks.

    A simulated robot, whose clock stands still meanwhile, waits for a decision before the first tick that it is for. A
    real one does not: it walks on as it was told before, and the decision counts from the tick after it is made.
    """

    def __init__(
        self,
        manifest: Manifest,
        policy: Policy,
        about: Robot,
        robot: DrivenRobot,
        patience: float = 0.0,
        waits: bool = True,
        **more: Any,
    ) -> None:
        """Prepares a run; the robot is not touched.

        Args:
            manifest: of the policy's folder, checked.
            policy: from an observation to a command (2,), m/s and rad/s.
            about: the robot's figures.
            robot: to run it on.
            patience: as for :class:`loco_mjx.deploy.runner.Runner`; of decisions, and of ticks.
            waits: whether ticks wait for a decision.
            **more: as for :class:`loco_mjx.deploy.walker.Walker`.

        Raises:
            UserError: if the policy is another controller's, or quadprog is missing.
        """
        super().__init__(about, lambda seconds: (0.0, 0.0), robot, patience=patience, manifest=manifest, **more)
        self.policy, self._period = policy, 1 / manifest.policy_hz
        self._every = ticks(manifest.policy_hz)
        self._policy_patience = max((1 + self.guard.limits.missed) * self._period, patience)
        self._held = np.zeros(manifest.controller.size)
        self._waits, self._thinker = waits, Worker("decisions")
        self._begun = 0.0
        self._answer: queue.SimpleQueue[Any] | None = None

    def _check_policy(self, sensors: Sensors, frame: Frame | None) -> None:
        """One tick and one decision that are thrown away; they also warm up the runtime."""
        super()._check_policy(sensors, frame)
        command = self.policy(Observer(self.manifest).observe(sensors, frame, None, self._low.mean_velocity()))
        size = self.manifest.controller.size
        if command.shape != (size,) or not np.all(np.isfinite(command)):
            raise UserError(f"the policy's output is not {size} numbers; export the run again")

    def _want(self, tick: int, seconds: float) -> np.ndarray:
        """The policy's command: a new one every control step."""
        self._spent = 0.0
        if self._waits and tick % self._every == 0:
            self._held = self._command_of_policy()
        elif not self._waits:
            self._take()
            if tick % self._every == 0 and self._answer is None:  # it is not asked again before it has answered
                self._ask()
        return self._held

    def _ask(self) -> None:
        """Has the policy decide on what is measured now."""
        self._begun = self._clock()
        sensors = self._measure()
        obs = self._observe(sensors, self._look(), self._held)
        self._answer = self._thinker.post(lambda: (self._asked(obs), self._clock()))
        self._spent = self._clock() - self._begun

    def _take(self) -> None:
        """Takes in what has been decided, if it has."""
        if self._answer is None:
            return
        try:
            decided, error = self._answer.get_nowait()
        except queue.Empty:
            if self._clock() - self._begun > self._policy_patience:
                raise self._overdue() from None
            return
        self._answer = None
        if error is not None:
            raise error
        command, ended = decided
        self.guard.action(command)
        self.guard.deadline(ended - self._begun, self._period, OF_POLICY)
        self._held = command

    def _overdue(self) -> Stop:
        return Stop(Cause.DEADLINE, f"a decision has not ended after {1000 * self._policy_patience:.0f} ms")

    def _flush(self) -> None:
        super()._flush()
        self._thinker.close()

    def _command_of_policy(self) -> np.ndarray:
        begin = self._clock()
        sensors = self._measure()
        sensed = self._clock() - begin
        decide: Callable[[], Any] = lambda: self._decide(sensors, self._held)  # noqa: E731
        try:
            _, _, command, took = self._worker.call(decide, self._policy_patience, self.estop.poll)
        except Overdue:
            raise self._overdue() from None
        self.guard.action(command)
        self.guard.deadline(sensed + took, self._period, OF_POLICY)
        return command

    def _observe(self, sensors: Sensors, frame: Frame | None, before: np.ndarray) -> dict[str, np.ndarray]:
        return self._observer.observe(sensors, frame, None, self._low.mean_velocity())
