"""Engine that runs a step in one compiled call, bit for bit equal to the pymunk engine."""

import math
import weakref
from collections.abc import Sequence
from functools import partial
from threading import Thread
from typing import Any, cast

import numpy as np
from llvmlite import ir  # type: ignore[import-untyped]
from numba import carray, types  # type: ignore[attr-defined]
from numba.extending import intrinsic
from numpy.typing import ArrayLike, NDArray

import tma_ray.physics.compiled.symbols as cp
from tma_ray.embodiments import Embodiment
from tma_ray.physics.base import GRAVITY, TIME_STEP, SolverSettings, first_steps, settings_for
from tma_ray.physics.chipmunk import chains, hung, settled
from tma_ray.physics.compiled.step import (
    BEFORE,
    Floats,
    Integers,
    new_memory,
    put_world,
    simulation_in,
    step,
    step_at,
)
from tma_ray.physics.compiled.world import build, count_contact, release
from tma_ray.physics.kernels import NOTHING, world_of
from tma_ray.physics.rules import Rules, observation_size, step_arrays
from tma_ray.support.jit import kernel
from tma_ray.terrain import Terrain

COUNT_CONTACT = cast("int", count_contact.address)  # address of the callback for contacts


class CompiledEngine:
    """Engine that calls Chipmunk from compiled code; takes the same arguments as `make_engine`.

    A copy or a pickle has the same body, and must be reset before its first step.
    """

    def __init__(self, body: Embodiment, rules: Rules, settings: SolverSettings | None = None) -> None:
        self.settings = settings or settings_for(body)
        self.arrays = step_arrays(body, rules)
        self._recipe = (body, rules, self.settings)
        self._body = settled(body, self.settings)
        self._memory = new_memory(self.arrays, len(self._body.limits), self.settings, COUNT_CONTACT)
        floats, integers = self._memory
        self._addresses = floats.ctypes.data, len(floats), integers.ctypes.data, len(integers)
        self._simulation = simulation = simulation_in(*self._memory)
        self.state, self.contacts = simulation.state, simulation.contacts
        self.grips, self.medium = simulation.grips, simulation.medium
        self._action, self._action_shape = simulation.action, simulation.action.shape
        self._observation_size = observation_size(self.arrays)
        self._release: Any = None

    def reset(self, terrain: Terrain, push: float) -> NDArray[np.float32]:
        """Build a new world and run its first steps; see `Engine`."""
        if self._release is not None:
            self._release()
            self._release = None  # so that a failed build cannot leave the freed world in use
        hangs = len(self.grips) > 0 and len(terrain.ceiling) > 0
        if hangs:
            terrain = hung(terrain, self._body, self.arrays)
        self._build(terrain, push)
        return first_steps(self, hangs)

    def step(self, action: ArrayLike) -> tuple[NDArray[np.float32], float, bool]:
        """Advance the world by TIME_STEP; see `Engine`."""
        values = np.asarray(action)
        if self._release is None:
            raise RuntimeError("this engine has no world yet: call reset first")
        if values.shape != self._action_shape:
            raise ValueError(f"an action has shape {self._action_shape}, got {values.shape}")
        self._action[:] = values
        observation = np.empty(self._observation_size, np.float32)
        reward, ended = step_at(*self._addresses, observation)
        if math.isnan(reward):
            raise ValueError(f"an action must be finite, got {values.tolist()}")
        return observation, reward, ended

    @property
    def creeper_poses(self) -> NDArray[np.float64]:
        """Poses of the creepers (c, 4); see `Engine`."""
        if self._release is None:
            raise RuntimeError("this engine has no world yet: call reset first")
        return self._world[0].poses

    @property
    def addresses(self) -> tuple[int, ...]:
        """Addresses and sizes of the memory's two vectors, for `_step_worlds`."""
        if self._release is None:
            raise RuntimeError("this engine has no world yet: call reset first")
        return self._addresses

    def _build(self, terrain: Terrain, push: float) -> None:
        simulation, forces = self._simulation, (GRAVITY, push * TIME_STEP)
        simulation.grips[:], simulation.holds[:], simulation.medium[:] = NOTHING, 0, 0
        simulation.wet[:] = 0
        shapes, swinging = build(
            self._body, terrain, chains(terrain), self.settings, forces, simulation.handles
        )
        handles = simulation.handles.copy()
        self._release = weakref.finalize(
            self, release, handles, simulation.holds, shapes, swinging, len(self.state)
        )
        self._world = world_of(terrain), swinging  # kept alive: the memory stores their addresses
        put_world(self._memory, *self._world)
        self._memory.floats[BEFORE] = 0.0

    def __reduce__(self) -> tuple[type["CompiledEngine"], tuple[Any, ...]]:
        return CompiledEngine, self._recipe


LINE = 8  # number of integers in a cache line

DONE, FAILED, END, CALL, LEFT = 0, 8, 9, 16, 24
"""Indices into `board`, an array shared by all threads: steps done, steps that failed, 1 to end the threads,
sizes and addresses of a call; from LEFT on, one cache line apart, the number of worlds that each thread has
yet to step."""

PATIENCE = 200  # polls before an idle thread sleeps, about 0.1 ms in all, since waking it is slow

_lock_new: Any = types.ExternalFunction("PyThread_allocate_lock", types.intp())
_lock_free: Any = types.ExternalFunction("PyThread_free_lock", types.void(types.intp))
_lock_take: Any = types.ExternalFunction("PyThread_acquire_lock", types.intc(types.intp, types.intc))
_lock_open: Any = types.ExternalFunction("PyThread_release_lock", types.void(types.intp))
_give_way: Any = types.ExternalFunction("sched_yield", types.intc())


def _atomic(operation: str) -> Any:
    """Return an atomic `operation` as a function (address, number) that returns the old value."""

    @intrinsic
    def change(_context: Any, _address: Any, _number: Any) -> Any:
        def generate(_context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
            pointer = builder.inttoptr(arguments[0], ir.PointerType(ir.IntType(64)))
            return builder.atomic_rmw(operation, pointer, arguments[1], "seq_cst")

        return types.int64(types.intp, types.int64), generate

    return change


_add, _exchange = _atomic("add"), _atomic("xchg")


@kernel
def _work(board: Integers, thread: int) -> None:
    """Step the remaining worlds of a call, those in the CPU cache of `thread` first."""
    threads = (len(board) - LEFT) // LINE
    for turn in range(threads):
        owner = (thread + turn) % threads
        ticket = _add(board[LEFT + LINE * owner :].ctypes.data, -1)
        while ticket > 0:
            worlds = board[CALL]
            _step_row(board, (owner + 1) * worlds // threads - ticket)
            _add(board[DONE:].ctypes.data, 1)
            ticket = _add(board[LEFT + LINE * owner :].ctypes.data, -1)


@kernel
def _step_row(board: Integers, row: int) -> None:
    """Step world `row` of the call whose arguments are stored in `board`, the array shared by all threads."""
    worlds, acting, seen = board[CALL : CALL + 3]
    addresses_at, actions_at, observations_at, rewards_at, ended_at = board[CALL + 3 : CALL + 8]
    addresses = carray(cp.as_pointer(addresses_at), (worlds, 4), np.int64)
    actions = carray(cp.as_pointer(actions_at), (worlds, acting), np.float32)
    observations = carray(cp.as_pointer(observations_at), (worlds, seen), np.float32)
    rewards = carray(cp.as_pointer(rewards_at), worlds, np.float64)
    ended = carray(cp.as_pointer(ended_at), worlds, np.bool_)
    try:
        floats_at, floats_size, integers_at, integers_size = addresses[row]
        floats = carray(cp.as_pointer(floats_at), floats_size, np.float64)
        integers = carray(cp.as_pointer(integers_at), integers_size, np.int64)
        simulation_in(floats, integers).action[:] = actions[row]
        rewards[row], ended[row] = step(floats, integers, observations[row])
    except Exception:  # `_step_worlds` raises once all worlds are done
        _add(board[FAILED:].ctypes.data, 1)


@partial(kernel, nogil=True)
def _serve(board: Integers, lock: int, thread: int) -> None:
    """Main loop of a thread: step worlds of every call until `END` is set in the shared array `board`."""
    while board[END] == 0:
        _work(board, thread)
        polls = 0
        while board[LEFT + LINE * thread] <= 0 and polls < PATIENCE:
            _give_way()
            polls += 1
        if polls == PATIENCE:
            _lock_take(lock, 1)


@kernel
def _wake(locks: Integers) -> None:
    """Release all locks; free ones are acquired first, since only a held lock can be released."""
    for lock in locks:
        _lock_take(lock, 0)
        _lock_open(lock)


@partial(kernel, nogil=True)
def _step_worlds(
    board: Integers,
    locks: Integers,
    addresses: Integers,
    actions: NDArray[np.float32],
    observations: NDArray[np.float32],
    rewards: Floats,
    ended: NDArray[np.bool_],
) -> None:
    """Step the worlds at `addresses` (k, 4); see `EngineBatch.step`."""
    worlds = len(addresses)
    board[CALL : CALL + 3] = worlds, actions.shape[1], observations.shape[1]
    board[CALL + 3], board[CALL + 4] = addresses.ctypes.data, actions.ctypes.data
    board[CALL + 5], board[CALL + 6] = observations.ctypes.data, rewards.ctypes.data
    board[CALL + 7] = ended.ctypes.data
    _exchange(board[DONE:].ctypes.data, 0)
    threads = len(locks) + 1
    for owner in range(threads):
        tickets = (owner + 1) * worlds // threads - owner * worlds // threads
        _exchange(board[LEFT + LINE * owner :].ctypes.data, tickets)
    _wake(locks[: worlds - 1])
    _work(board, 0)
    while _add(board[DONE:].ctypes.data, 0) < worlds:
        _give_way()
    if _exchange(board[FAILED:].ctypes.data, 0) > 0:
        raise RuntimeError("the step of a world failed: its memory is damaged, or there is none left")


@kernel
def _new_locks(locks: Integers) -> None:
    for index in range(len(locks)):
        locks[index] = _lock_new()


@kernel
def _free_locks(locks: Integers) -> None:
    for lock in locks:
        _lock_free(lock)


class EngineBatch:
    """Batch of engines of one body, stepped in one compiled call by several threads.

    All engines must have been reset, and may be reset again. The threads end with this object or the
    interpreter.

    Args:
        engines: engines of the worlds.
        threads: number of threads, the caller's included, which does not change results.
    """

    def __init__(self, engines: Sequence[CompiledEngine], threads: int = 1) -> None:
        self._engines = engines  # kept alive: the addresses of their memories are stored
        self._addresses = np.array([engine.addresses for engine in engines], dtype=np.int64)
        body = engines[0].arrays
        self._observation_size, self._action_size = observation_size(body), len(body.motors) + len(body.grips)
        self._board = np.zeros(LEFT + LINE * threads, np.int64)
        self._locks = np.zeros(threads - 1, np.int64)
        _new_locks(self._locks)
        crew: list[Thread] = []
        weakref.finalize(self, _end, self._board, self._locks, crew)
        if threads > 1:
            self._board[END] = 1
            _serve(self._board, 0, 0)  # compiles once, before the threads start
            self._board[END] = 0
        for index, lock in enumerate(self._locks.tolist(), 1):
            thread = Thread(
                target=_serve, args=(self._board, lock, index), name="tma_ray worlds", daemon=True
            )
            thread.start()
            crew.append(thread)

    def step(
        self, rows: NDArray[np.int64], actions: NDArray[np.float32]
    ) -> tuple[NDArray[np.float32], NDArray[np.float64], NDArray[np.bool_]]:
        """Advance the worlds `rows` (k,) with `actions` (k, a); see `Engine.step`.

        Results are bit for bit those of stepping the worlds one by one. The method is not thread-safe.

        Raises:
            ValueError: if actions have another shape or are not finite.
            RuntimeError: if a step fails.
        """
        expected = len(rows), self._action_size
        if actions.shape != expected:
            raise ValueError(f"actions of {len(rows)} worlds have shape {expected}, got {actions.shape}")
        observations = np.empty((len(rows), self._observation_size), np.float32)
        rewards, ended = np.empty(len(rows)), np.empty(len(rows), np.bool_)
        addresses = self._addresses[rows]
        _step_worlds(self._board, self._locks, addresses, actions, observations, rewards, ended)
        if np.count_nonzero(np.isnan(rewards)):
            raise ValueError(f"actions must be finite, got {actions[np.isnan(rewards)][0].tolist()}")
        return observations, rewards, ended


def _end(board: Integers, locks: Integers, crew: Sequence[Thread]) -> None:
    """Stop the worker threads `crew`, then free their locks."""
    board[END] = 1
    _wake(locks)
    for thread in crew:
        thread.join()
    _free_locks(locks)
