"""Access from compiled code to Chipmunk's C functions, exported by pymunk's extension module.

A pointer is an intp. A cpVect argument is two doubles and a cpShapeFilter two integers, as the calling
conventions of x86-64 (not on Windows) and AArch64 pass structs of these sizes. Functions that take larger
structs, and private layouts, are not used.
"""

import platform
import sys
from typing import Any

import llvmlite.binding  # type: ignore[import-untyped]
import numba
import pymunk
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.imputils import impl_ret_borrowed
from numba.extending import intrinsic
from numba.np.arrayobj import populate_array
from pymunk import _chipmunk

MACHINES = ("x86_64", "amd64", "aarch64", "arm64")  # values of `platform.machine()` for x86-64 and AArch64

STRUCT_SIZES = {
    "cpVect": 16,
    "cpFloat": 8,
    "cpShapeFilter": 16,
    "cpBitmask": 4,
    "cpGroup": 8,
    "cpCollisionType": 8,
}
"""Sizes in bytes assumed by the declarations below."""


def load() -> None:
    """Make Chipmunk's functions callable from compiled code.

    Raises:
        RuntimeError: if numba is disabled, or this machine or pymunk has another calling convention.
    """
    if numba.config.DISABLE_JIT:  # type: ignore[attr-defined]
        raise RuntimeError("NUMBA_DISABLE_JIT is set")
    if sys.platform == "win32" or platform.machine().lower() not in MACHINES:
        raise RuntimeError(f"no known way to pass structs on {sys.platform} {platform.machine()}")
    for name, expected in STRUCT_SIZES.items():
        size = _chipmunk.ffi.sizeof(name)
        if size != expected:
            raise RuntimeError(f"a {name} of pymunk {pymunk.version} has {size} bytes instead of {expected}")
    llvmlite.binding.load_library_permanently(_chipmunk.__file__)
    for name in _NAMES:
        if llvmlite.binding.address_of_symbol(name) is None:
            raise RuntimeError(f"pymunk {pymunk.version} does not export {name}")


_NAMES: list[str] = ["cpArbiterGetShapes"]  # all symbols declared below


def _function(name: str, result: types.Type, *arguments: types.Type) -> Any:
    _NAMES.append(name)
    return types.ExternalFunction(name, result(*arguments))


def _vector_of(name: str) -> Any:
    """Wrap the C function `name`, which maps a pointer to a cpVect, as a function that returns (x, y)."""
    _NAMES.append(name)

    @intrinsic
    def getter(_context: Any, _pointer: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            vector = ir.LiteralStructType([ir.DoubleType(), ir.DoubleType()])
            kind = ir.FunctionType(vector, [argument.type for argument in arguments])
            function = cgutils.get_or_insert_function(builder.module, kind, name)  # type: ignore[no-untyped-call]
            result = builder.call(function, arguments)
            values = [builder.extract_value(result, index) for index in range(2)]
            return context.make_tuple(builder, signature.return_type, values)

        pair: Any = types.UniTuple(types.float64, 2)  # type: ignore[no-untyped-call]
        return pair(types.intp), generate

    return getter


@intrinsic
def _as_pointer(_context: Any, _address: Any) -> Any:
    """Convert an address (intp) to a pointer for numba's carray."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.inttoptr(arguments[0], context.get_value_type(signature.return_type))

    return types.voidptr(types.intp), generate


as_pointer: Any = _as_pointer  # called with the address only; numba adds the context


@intrinsic
def _part(_context: Any, vector: Any, _at: Any, shape: Any) -> Any:
    """Return a view (n,) or (n, m) that begins at an index of `vector`, without bounds checks.

    It is one instruction; numba's slices and ``reshape`` check each size and call a function.
    """
    kind = types.Array(vector.dtype, shape.count, "C")

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        whole = context.make_array(signature.args[0])(context, builder, arguments[0])
        part = context.make_array(kind)(context, builder)
        sizes = cgutils.unpack_tuple(builder, arguments[2])  # type: ignore[no-untyped-call]
        strides = [builder.mul(sizes[-1], whole.itemsize), whole.itemsize][-len(sizes) :]
        data = builder.gep(whole.data, [arguments[1]])
        owner = {"meminfo": whole.meminfo, "parent": whole.parent}
        populate_array(part, data, sizes, strides, whole.itemsize, **owner)  # type: ignore[no-untyped-call]
        return impl_ret_borrowed(context, builder, kind, part._getvalue())  # type: ignore[no-untyped-call]

    return kind(vector, types.intp, types.UniTuple(types.intp, shape.count)), generate  # type: ignore[no-untyped-call]


part: Any = _part  # called with vector, index and shape


@intrinsic
def _other_shape(_context: Any, _arbiter: Any) -> Any:
    """Return the pointer to the second shape of a contact (an arbiter of Chipmunk)."""

    def generate(context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        pointer = context.get_value_type(types.intp)
        shapes = [cgutils.alloca_once(builder, pointer) for _ in range(2)]  # type: ignore[no-untyped-call]
        kind = ir.FunctionType(ir.VoidType(), [pointer, *(shape.type for shape in shapes)])
        function = cgutils.get_or_insert_function(  # type: ignore[no-untyped-call]
            builder.module, kind, "cpArbiterGetShapes"
        )
        builder.call(function, [arguments[0], *shapes])
        return builder.load(shapes[1])

    return types.intp(types.intp), generate


other_shape: Any = _other_shape  # called with the arbiter


_void, _pointer, _int, _double = types.void, types.intp, types.intc, types.float64
_vector = (_double, _double)

space_new = _function("cpSpaceNew", _pointer)
space_free = _function("cpSpaceFree", _void, _pointer)
space_set_iterations = _function("cpSpaceSetIterations", _void, _pointer, _int)
space_set_gravity = _function("cpSpaceSetGravity", _void, _pointer, *_vector)
space_set_collision_slop = _function("cpSpaceSetCollisionSlop", _void, _pointer, _double)
space_set_collision_bias = _function("cpSpaceSetCollisionBias", _void, _pointer, _double)
space_static_body = _function("cpSpaceGetStaticBody", _pointer, _pointer)
space_add_body = _function("cpSpaceAddBody", _pointer, _pointer, _pointer)
space_add_shape = _function("cpSpaceAddShape", _pointer, _pointer, _pointer)
space_add_constraint = _function("cpSpaceAddConstraint", _pointer, _pointer, _pointer)
space_remove_constraint = _function("cpSpaceRemoveConstraint", _void, _pointer, _pointer)
space_step = _function("cpSpaceStep", _void, _pointer, _double)

body_new = _function("cpBodyNew", _pointer, _double, _double)
body_free = _function("cpBodyFree", _void, _pointer)
body_set_centre = _function("cpBodySetCenterOfGravity", _void, _pointer, *_vector)
body_set_angle = _function("cpBodySetAngle", _void, _pointer, _double)
body_set_position = _function("cpBodySetPosition", _void, _pointer, *_vector)
body_push = _function("cpBodyApplyImpulseAtLocalPoint", _void, _pointer, *_vector, *_vector)
body_set_force = _function("cpBodySetForce", _void, _pointer, *_vector)
body_set_torque = _function("cpBodySetTorque", _void, _pointer, _double)
body_each_arbiter = _function("cpBodyEachArbiter", _void, _pointer, _pointer, _pointer)
body_angle = _function("cpBodyGetAngle", _double, _pointer)
body_angular_velocity = _function("cpBodyGetAngularVelocity", _double, _pointer)
body_rotation = _vector_of("cpBodyGetRotation")
body_position = _vector_of("cpBodyGetPosition")
body_velocity = _vector_of("cpBodyGetVelocity")

convex_hull = _function("cpConvexHull", _int, _int, _pointer, _pointer, _pointer, _double)
polygon_new = _function("cpPolyShapeNewRaw", _pointer, _pointer, _int, _pointer, _double)
shape_free = _function("cpShapeFree", _void, _pointer)
shape_set_friction = _function("cpShapeSetFriction", _void, _pointer, _double)
shape_set_filter = _function("cpShapeSetFilter", _void, _pointer, _pointer, types.int64)
shape_set_collision_type = _function("cpShapeSetCollisionType", _void, _pointer, _pointer)
shape_collision_type = _function("cpShapeGetCollisionType", _pointer, _pointer)

motor_new = _function("cpSimpleMotorNew", _pointer, _pointer, _pointer, _double)
motor_set_rate = _function("cpSimpleMotorSetRate", _void, _pointer, _double)
limit_new = _function("cpRotaryLimitJointNew", _pointer, _pointer, _pointer, _double, _double)
pivot_new = _function("cpPivotJointNew2", _pointer, _pointer, _pointer, *_vector, *_vector)
constraint_free = _function("cpConstraintFree", _void, _pointer)
constraint_impulse = _function("cpConstraintGetImpulse", _double, _pointer)
constraint_set_max_force = _function("cpConstraintSetMaxForce", _void, _pointer, _double)
constraint_set_max_bias = _function("cpConstraintSetMaxBias", _void, _pointer, _double)
constraint_set_error_bias = _function("cpConstraintSetErrorBias", _void, _pointer, _double)

load()
