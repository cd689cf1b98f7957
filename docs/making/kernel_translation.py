"""Translation of kernels from a subset of Python to C.

As in numba, each function is specialised for the types of its arguments, and types of variables are inferred
from assignments. Arrays are contiguous, and only constant indices may be negative. Sums and products keep
their order, so that C without contraction gives the bits of the compiled kernel.
"""

import ast
import inspect
import math
import textwrap
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeAlias

import numpy as np

FLAG, WHOLE, SINGLE, REAL, NOTHING = "bool", "i64", "float", "double", "void"  # C's scalar types

_PROMOTION = (FLAG, WHOLE, SINGLE, REAL)
_TYPES = {"float64": REAL, "float32": SINGLE, "int64": WHOLE, "bool": FLAG}
_PAIRS = "Add +;Sub -;Mult *;Div /;FloorDiv /;Mod %;Lt <;LtE <=;Gt >;GtE >=;Eq ==;NotEq !="
_SIGNS: dict[str, str] = dict(pair.split() for pair in _PAIRS.split(";"))  # C operators by names of AST nodes

PRELUDE = """\
#include <math.h>
#include <stdbool.h>
#include <stdint.h>
#include <string.h>
typedef int64_t i64;
void *new_array(i64 bytes);
static void reset_arrays(void);
#define EXTREMES(kind) \\
  static inline kind min_##kind(kind a, kind b) { return b < a ? b : a; } \\
  static inline kind max_##kind(kind a, kind b) { return b > a ? b : a; } \\
  static kind min_of_##kind(kind *p, i64 n) { kind m = *p; while (--n) m = min_##kind(m, *++p); return m; } \\
  static kind max_of_##kind(kind *p, i64 n) { kind m = *p; while (--n) m = max_##kind(m, *++p); return m; }
EXTREMES(double) EXTREMES(float) EXTREMES(i64)
"""
"""Beginning of the C file; memory from ``new_array`` is freed at the next call of an exported function."""


class TranslationError(ValueError):
    """Error raised if a kernel is outside the supported subset of Python."""


@dataclass(frozen=True)
class ArrayType:
    """Type of a contiguous array: the type of its values and its number of dimensions."""

    kind: str
    dimensions: int


@dataclass(frozen=True)
class TupleType:
    """Type of a tuple: the types of its items, with their names if it is a NamedTuple."""

    items: tuple["Type", ...]
    names: tuple[str, ...] = ()

    @property
    def uniform(self) -> bool:
        """True for a plain tuple with items of one type, which a variable can index."""
        return not self.names and len(set(self.items)) == 1

    def member(self, index: int) -> str:
        """Return the name of the struct member of an item."""
        if self.uniform:
            return f"v[{index}]"
        return self.names[index] if self.names else f"v{index}"


Type: TypeAlias = str | ArrayType | TupleType
Value: TypeAlias = tuple[str, Type]  # a C expression and its type


def type_of(example: Any) -> Type:
    """Return the type of a value: a number, an array, or a tuple of these."""
    if isinstance(example, np.ndarray):
        return ArrayType(_TYPES[example.dtype.name], example.ndim)
    if isinstance(example, tuple):
        return TupleType(tuple(map(type_of, example)), tuple(getattr(example, "_fields", ())))
    if isinstance(example, bool | np.bool_):
        return FLAG
    return WHOLE if isinstance(example, int | np.integer) else REAL


@dataclass
class Translation:
    """C file with the translations of functions and their callees.

    Args:
        externals: result type of every external C function, by its name in Python.

    Attributes:
        functions: definitions in C, callees first.
    """

    externals: Mapping[str, Type]
    functions: list[str] = field(default_factory=list)
    _types: dict[Type, str] = field(default_factory=dict)
    _structs: list[str] = field(default_factory=list)
    _made: dict[tuple[Any, tuple[Type, ...]], Value] = field(default_factory=dict)
    _exports: list[str] = field(default_factory=list)

    def export(self, name: str, kernel: Callable[..., Any], *examples: Any) -> None:
        """Export `kernel` under a name, for arguments of the types of `examples`.

        Its parameters are the addresses of two vectors of doubles, for the arguments (an array is its address
        and sizes, a tuple its items) and for the result.
        """
        types = tuple(map(type_of, examples))
        called, result = self.function(kernel, types)
        indices = iter(range(1000))
        arguments = ", ".join(self._unpacked(kind, indices) for kind in types)
        lines = [
            f"{self.name(result)} r = {called}({arguments});"
            if result != NOTHING
            else f"{called}({arguments});"
        ]
        lines += [f"out[{index}] = {value};" for index, value in enumerate(_leaves("r", result))]
        body = " ".join(lines)
        self._exports.append(
            f'__attribute__((export_name("{name}"))) void export_{name}(const double *in, double *out)'
            f" {{ (void)out; reset_arrays(); {body} }}"
        )

    def text(self, externals: str = "") -> str:
        """Return the text of the C file, with the code `externals` between types and functions."""
        vector = f"typedef {self.name(TupleType((REAL, REAL)))} vector;"
        parts = [PRELUDE, *self._structs, vector, externals, *self.functions, *self._exports]
        return "\n".join(parts) + "\n"

    def name(self, kind: Type) -> str:
        """Return the name of a type in C."""
        if isinstance(kind, str):
            return kind
        if kind not in self._types:
            self._types[kind] = name = f"type_{len(self._types)}"
            self._structs.append(f"typedef struct {{ {self._members(kind)} }} {name};")
            self._types[kind] = name
        return self._types[kind]

    def function(self, kernel: Callable[..., Any], arguments: tuple[Type, ...]) -> Value:
        """Return the C name and result type of `kernel` for argument types, translating it on first use."""
        plain: Any = getattr(kernel, "py_func", None) or getattr(kernel, "_pyfunc", kernel)
        key = plain, arguments
        if key not in self._made:
            name = f"{plain.__name__.lstrip('_')}_{len(self._made)}"
            self._made[key] = name, NOTHING
            self._made[key] = name, _Function(self, plain, arguments).define(name)
        return self._made[key]

    def _members(self, kind: ArrayType | TupleType) -> str:
        if isinstance(kind, ArrayType):
            return f"{kind.kind} *p; i64 {', '.join(f'n{axis}' for axis in range(kind.dimensions))};"
        if kind.uniform:
            return f"{self.name(kind.items[0])} v[{len(kind.items)}];"
        return (
            " ".join(f"{self.name(item)} {kind.member(index)};" for index, item in enumerate(kind.items))
            or "int _;"
        )

    def _unpacked(self, kind: Type, indices: Iterator[int]) -> str:
        """Return the C expression that reads an argument of an exported function from its input vector."""
        if isinstance(kind, str):
            return f"({kind})in[{next(indices)}]"
        if isinstance(kind, ArrayType):
            address = f"({kind.kind} *)(intptr_t)in[{next(indices)}]"
            items = [address, *(f"(i64)in[{next(indices)}]" for _ in range(kind.dimensions))]
        else:
            items = [self._unpacked(item, indices) for item in kind.items]
            if kind.uniform:
                return f"({self.name(kind)}){{{{{', '.join(items)}}}}}"
        return f"({self.name(kind)}){{{', '.join(items)}}}"


def _leaves(code: str, kind: Type) -> Iterator[str]:
    if isinstance(kind, ArrayType):
        yield f"(double)(intptr_t){code}.p"
        yield from (f"{code}.n{axis}" for axis in range(kind.dimensions))
    elif isinstance(kind, TupleType):
        for index, item in enumerate(kind.items):
            yield from _leaves(f"{code}.{kind.member(index)}", item)
    elif kind != NOTHING:
        yield code


class _Function:
    """Translation of one function for given types of its arguments."""

    def __init__(self, translation: Translation, function: Any, arguments: tuple[Type, ...]) -> None:
        self._translation, self._function = translation, function
        tree = ast.parse(textwrap.dedent(inspect.getsource(function))).body[0]
        assert isinstance(tree, ast.FunctionDef)
        self._tree, self._globals = tree, function.__globals__
        self._parameters = [argument.arg for argument in tree.args.args]
        self._variables: dict[str, Type] = dict(zip(self._parameters, arguments, strict=True))
        self._result: Type = NOTHING
        self._lines: list[str] = []
        self._temporaries = 0

    def define(self, name: str) -> Type:
        """Add the C definition of the function, and return the type of its result."""
        inferred = None
        while inferred != (self._variables, self._result):  # later assignments may change types
            inferred = dict(self._variables), self._result
            self._lines, self._temporaries = [], 0
            self._block(self._tree.body)
        c = self._translation.name
        variables = {variable: f"{c(kind)} {_safe(variable)}" for variable, kind in self._variables.items()}
        parameters = ", ".join(variables.pop(parameter) for parameter in self._parameters)
        declared = [f"{variable};" for variable in variables.values()]
        body = "\n".join([*declared, *self._lines])
        self._translation.functions.append(
            f"static {c(self._result)} {name}({parameters})\n{{\n{textwrap.indent(body, '  ')}\n}}"
        )
        return self._result

    # Statements

    def _block(self, statements: Sequence[ast.stmt]) -> None:
        for statement in statements:
            handler = getattr(self, f"_do_{type(statement).__name__.lower()}", None)
            if handler is None:
                raise self._error(statement, "has no counterpart")
            handler(statement)

    def _do_expr(self, statement: ast.Expr) -> None:
        if not isinstance(statement.value, ast.Constant):  # skip docstrings
            self._lines.append(f"{self._value(statement.value)[0]};")

    def _do_continue(self, _statement: ast.Continue) -> None:
        self._lines.append("continue;")

    def _do_return(self, statement: ast.Return) -> None:
        if statement.value is None:
            self._lines.append("return;")
            return
        code, kind = self._value(statement.value)
        self._result = _unified(self._result, kind) if self._result != NOTHING else kind
        self._lines.append(f"return {code};")

    def _do_assign(self, statement: ast.Assign | ast.AnnAssign) -> None:
        target = statement.targets[0] if isinstance(statement, ast.Assign) else statement.target
        assert statement.value is not None
        if isinstance(target, ast.Tuple):
            for item, value in zip(target.elts, self._items(statement.value, len(target.elts)), strict=True):
                self._store(item, value)
        else:
            self._store(target, self._value(statement.value))

    _do_annassign = _do_assign

    def _do_augassign(self, statement: ast.AugAssign) -> None:
        operation = ast.BinOp(_loaded(statement.target), statement.op, statement.value)
        self._store(statement.target, self._value(ast.copy_location(operation, statement)))

    def _do_if(self, statement: ast.If) -> None:
        self._lines.append(f"if ({self._value(statement.test)[0]}) {{")
        self._block(statement.body)
        if statement.orelse:
            self._lines.append("} else {")
            self._block(statement.orelse)
        self._lines.append("}")

    def _do_while(self, statement: ast.While) -> None:
        self._lines.append(f"while ({self._value(statement.test)[0]}) {{")
        self._block(statement.body)
        self._lines.append("}")

    def _do_for(self, statement: ast.For) -> None:
        assert isinstance(statement.target, ast.Name)
        over = statement.iter
        if isinstance(over, ast.Call) and isinstance(over.func, ast.Name) and over.func.id == "range":
            limits = [self._value(limit)[0] for limit in over.args]
            start, stop, step = ["0", *limits, "1"] if len(limits) == 1 else [*limits, "1"][:3]
            name, kind = statement.target.id, WHOLE
            self._assigned(name, kind)
            counter = self._temporary()
            end = self._temporary()
            self._lines.append(
                f"for (i64 {counter} = {start}, {end} = {stop}; {counter} < {end}; {counter} += {step}) {{ "
                f"{_safe(name)} = {counter};"
            )
        else:
            array = self._value(over)
            assert isinstance(array[1], ArrayType)
            counter = self._temporary()
            self._lines.append(f"for (i64 {counter} = 0; {counter} < ({array[0]}).n0; {counter}++) {{")
            self._store(statement.target, self._element(array, [counter]))
        self._block(statement.body)
        self._lines.append("}")

    def _store(self, target: ast.expr, value: Value) -> None:
        code, kind = value
        if isinstance(target, ast.Name):
            self._assigned(target.id, kind)
            self._lines.append(f"{_safe(target.id)} = {code};")
            return
        destination = self._value(_loaded(target))
        if isinstance(destination[1], ArrayType):
            self._fill(destination, value)
        else:
            self._lines.append(f"{destination[0]} = {code};")

    def _fill(self, destination: Value, value: Value) -> None:
        """Copy a number, an array or the items of a tuple into an array."""
        (into, kind), (source, source_kind) = self._kept(destination), self._kept(value)
        assert isinstance(kind, ArrayType)
        if isinstance(source_kind, TupleType):
            for index in range(len(source_kind.items)):
                self._lines.append(f"{into}.p[{index}] = {source}.{source_kind.member(index)};")
            return
        counter, size = self._temporary(), " * ".join(f"{into}.n{axis}" for axis in range(kind.dimensions))
        item = f"{source}.p[{counter}]" if isinstance(source_kind, ArrayType) else source
        self._lines.append(
            f"for (i64 {counter} = 0; {counter} < {size}; {counter}++) {into}.p[{counter}] = {item};"
        )

    def _assigned(self, name: str, kind: Type) -> None:
        self._variables[name] = _unified(self._variables[name], kind) if name in self._variables else kind

    def _items(self, node: ast.expr, count: int) -> list[Value]:
        """Return the items of an expression, evaluated before any of them is assigned."""
        if isinstance(node, ast.Tuple):
            values = [self._value(item) for item in node.elts]
            return [self._kept(value) for value in values]
        whole = self._kept(self._value(node))
        if isinstance(whole[1], ArrayType):
            return [self._element(whole, [str(index)]) for index in range(count)]
        assert isinstance(whole[1], TupleType)
        return [(f"{whole[0]}.{whole[1].member(index)}", whole[1].items[index]) for index in range(count)]

    def _kept(self, value: Value) -> Value:
        """Store a value in a new variable, and return the variable."""
        name = self._temporary()
        self._lines.append(f"{self._translation.name(value[1])} {name} = {value[0]};")
        return name, value[1]

    def _temporary(self) -> str:
        self._temporaries += 1
        return f"t{self._temporaries}"

    # Expressions

    def _value(self, node: ast.expr) -> Value:
        handler = getattr(self, f"_of_{type(node).__name__.lower()}", None)
        if handler is None:
            raise self._error(node, "has no counterpart")
        value: Value = handler(node)
        return value

    def _of_constant(self, node: ast.Constant) -> Value:
        return self._literal(node, node.value)

    def _of_name(self, node: ast.Name) -> Value:
        if node.id in self._variables:
            return _safe(node.id), self._variables[node.id]
        return self._literal(node, self._globals.get(node.id))

    def _of_attribute(self, node: ast.Attribute) -> Value:
        if isinstance(node.value, ast.Name) and node.value.id not in self._variables:
            return self._literal(node, getattr(self._globals.get(node.value.id), node.attr, None))
        if node.attr == "data":  # as in array.ctypes.data
            assert isinstance(node.value, ast.Attribute)
            return f"(i64)(intptr_t)({self._value(node.value.value)[0]}).p", WHOLE
        code, kind = self._value(node.value)
        if not isinstance(kind, TupleType) or node.attr not in kind.names:
            raise self._error(node, "is not a field")
        return f"{code}.{node.attr}", kind.items[kind.names.index(node.attr)]

    def _of_tuple(self, node: ast.Tuple) -> Value:
        return self._record([self._value(item) for item in node.elts], ())

    def _of_subscript(self, node: ast.Subscript) -> Value:
        whole = self._value(node.value)
        if isinstance(whole[1], TupleType):
            if isinstance(node.slice, ast.Constant):
                index = int(node.slice.value)  # type: ignore[arg-type]
                return f"{whole[0]}.{whole[1].member(index)}", whole[1].items[index]
            if not whole[1].uniform:
                raise self._error(node, "chooses among items of several types")
            return f"({whole[0]}).v[{self._value(node.slice)[0]}]", whole[1].items[0]
        if isinstance(node.slice, ast.Slice):
            return self._sliced(whole, node.slice)
        indices = node.slice.elts if isinstance(node.slice, ast.Tuple) else [node.slice]
        return self._element(
            whole, [self._index(whole[0], axis, index) for axis, index in enumerate(indices)]
        )

    def _index(self, array: str, axis: int, node: ast.expr) -> str:
        code = self._value(node)[0]
        negative = isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub)
        return f"({array}).n{axis} + {code}" if negative else code

    def _element(self, array: Value, indices: Sequence[str]) -> Value:
        code, kind = array
        assert isinstance(kind, ArrayType)
        offset = f"({indices[0]})"
        for axis in range(1, kind.dimensions):
            inner = f" + ({indices[axis]})" if axis < len(indices) else ""
            offset = f"({offset} * ({code}).n{axis}{inner})"
        if len(indices) == kind.dimensions:
            return f"({code}).p[{offset}]", kind.kind
        rest = ArrayType(kind.kind, kind.dimensions - len(indices))
        sizes = [f"({code}).n{axis}" for axis in range(len(indices), kind.dimensions)]
        return self._view(rest, f"({code}).p + {offset}", sizes)

    def _sliced(self, array: Value, cut: ast.Slice) -> Value:
        code, kind = array
        assert isinstance(kind, ArrayType)
        start = self._value(cut.lower)[0] if cut.lower else "0"
        stop = self._index(code, 0, cut.upper) if cut.upper else f"({code}).n0"
        sizes = [f"({stop}) - ({start})", *(f"({code}).n{axis}" for axis in range(1, kind.dimensions))]
        width = " * ".join([f"({start})", *(f"({code}).n{axis}" for axis in range(1, kind.dimensions))])
        return self._view(kind, f"({code}).p + {width}", sizes)

    def _of_ifexp(self, node: ast.IfExp) -> Value:
        (yes, first), (no, second) = self._value(node.body), self._value(node.orelse)
        return f"({self._value(node.test)[0]} ? {yes} : {no})", _unified(first, second)

    def _of_boolop(self, node: ast.BoolOp) -> Value:
        sign = " && " if isinstance(node.op, ast.And) else " || "
        return f"({sign.join(self._value(value)[0] for value in node.values)})", FLAG

    def _of_unaryop(self, node: ast.UnaryOp) -> Value:
        code, kind = self._value(node.operand)
        if isinstance(node.op, ast.Not):
            return f"!({code})", FLAG
        return f"(-{code})", kind

    def _of_compare(self, node: ast.Compare) -> Value:
        codes = [self._value(operand)[0] for operand in (node.left, *node.comparators)]
        signs = [_SIGNS[type(operator).__name__] for operator in node.ops]
        pairs = [f"({a} {sign} {b})" for a, sign, b in zip(codes, signs, codes[1:], strict=False)]
        return f"({' && '.join(pairs)})", FLAG

    def _of_binop(self, node: ast.BinOp) -> Value:
        (left, first), (right, second) = self._value(node.left), self._value(node.right)
        kind = _unified(_unified(first, second), WHOLE)
        if isinstance(node.op, ast.Div) and kind == WHOLE:
            left, kind = f"(double)({left})", REAL
        return f"({left} {_SIGNS[type(node.op).__name__]} {right})", kind

    def _of_call(self, node: ast.Call) -> Value:
        function = node.func
        if isinstance(function, ast.Attribute) and not (
            isinstance(function.value, ast.Name) and function.value.id not in self._variables
        ):
            return self._method(self._value(function.value), function.attr, node)
        if isinstance(function, ast.Attribute):
            module = self._globals[function.value.id]  # type: ignore[attr-defined]
            return self._library(module.__name__, function.attr, node)
        assert isinstance(function, ast.Name)
        if function.id in _BUILT_IN:
            return _BUILT_IN[function.id](self, [self._value(argument) for argument in node.args])
        called = self._globals.get(function.id)
        if called is None:
            raise self._error(node, "calls what C does not have")
        if function.id == "carray":
            address, shape = (self._value(argument) for argument in node.args[:2])
            return self._shaped(address[0], shape, _dtype(node, WHOLE))
        values = [self._value(argument) for argument in node.args]
        if hasattr(called, "_fields"):
            return self._record(values, called._fields)
        name, result = self._translation.function(called, tuple(kind for _, kind in values))
        return f"{name}({', '.join(code for code, _ in values)})", result

    def _library(self, module: str, name: str, node: ast.Call) -> Value:
        """Return a call to `math`, numpy or an external function."""
        if module == "numpy" and name in ("empty", "zeros"):
            return self._new_array(self._sizes(self._value(node.args[0])), _dtype(node, REAL))
        values = [self._value(argument) for argument in node.args]
        if module == "numpy" and name in ("array", "float32"):  # arrays of tuples are only assigned to rows
            return values[0] if name == "array" else (f"(float)({values[0][0]})", SINGLE)
        if module in ("math", "numpy"):
            kind = values[0][1] if name in ("sqrt", "tanh") else REAL
            suffix = "f" if kind == SINGLE else ""
            flags = name in ("isfinite", "isnan")
            return f"{name}{suffix}({', '.join(code for code, _ in values)})", FLAG if flags else kind
        if name == "part":
            start = f"(i64)(intptr_t)(({values[0][0]}).p + {values[1][0]})"
            assert isinstance(values[0][1], ArrayType)
            return self._shaped(start, values[2], values[0][1].kind)
        if name == "as_pointer":
            return values[0]
        if name not in self._translation.externals:
            raise self._error(node, "calls what C does not have")
        result = self._translation.externals[name]
        self._translation.name(result)
        return f"{name}({', '.join(code for code, _ in values)})", result

    def _method(self, array: Value, name: str, node: ast.Call) -> Value:
        code, kind = array
        assert isinstance(kind, ArrayType)
        if name == "reshape":
            return self._shaped(f"(i64)(intptr_t)({code}).p", self._value(node.args[0]), kind.kind)
        if name == "copy":
            sizes = [f"({code}).n{axis}" for axis in range(kind.dimensions)]
            made = self._new_array(sizes, kind.kind)
            self._fill(made, array)
            return made
        if name in ("min", "max"):
            return f"{name}_of_{kind.kind}(({code}).p, ({code}).n0)", kind.kind
        raise self._error(node, "is a method without a counterpart")

    def _new_array(self, sizes: Sequence[str], kind: str) -> Value:
        """Return a new array of zeros."""
        memory = f"new_array(sizeof({kind}) * {' * '.join(f'({size})' for size in sizes)})"
        return self._kept(self._view(ArrayType(kind, len(sizes)), memory, sizes))

    def _shaped(self, address: str, shape: Value, kind: str) -> Value:
        """Return an array with a shape that is a view of the memory at an address."""
        sizes = self._sizes(shape)
        return self._view(ArrayType(kind, len(sizes)), f"({kind} *)(intptr_t)({address})", sizes)

    def _sizes(self, shape: Value) -> list[str]:
        if isinstance(shape[1], TupleType):
            return [f"({shape[0]}).{shape[1].member(axis)}" for axis in range(len(shape[1].items))]
        return [shape[0]]

    def _view(self, kind: ArrayType, pointer: str, sizes: Sequence[str]) -> Value:
        return f"(({self._translation.name(kind)}){{{', '.join([pointer, *sizes])}}})", kind

    def _record(self, values: Sequence[Value], names: tuple[str, ...]) -> Value:
        kind = TupleType(tuple(item for _, item in values), names)
        items = ", ".join(code for code, _ in values)
        return f"(({self._translation.name(kind)}){{{f'{{{items}}}' if kind.uniform else items}}})", kind

    def _literal(self, node: ast.expr, value: Any) -> Value:
        if isinstance(value, bool):
            return str(value).lower(), FLAG
        if isinstance(value, int):
            return f"{value}", WHOLE
        if not isinstance(value, float):
            raise self._error(node, f"is {value!r:.40}: expected a number")
        if math.isfinite(value):
            return value.hex() if value >= 0 else f"({value.hex()})", REAL
        return "NAN" if math.isnan(value) else "INFINITY" if value > 0 else "(-INFINITY)", REAL

    def _error(self, node: ast.AST, problem: str) -> TranslationError:
        where = f"{self._function.__module__}.{self._function.__name__}"
        return TranslationError(f"{where}: {ast.unparse(node)!r} {problem} in the translation to C")


def _chosen(name: str) -> Callable[[_Function, list[Value]], Value]:
    def call(_: _Function, values: list[Value]) -> Value:
        kind = _unified(values[0][1], values[1][1])
        return f"{name}_{kind}({values[0][0]}, {values[1][0]})", kind

    return call


_BUILT_IN: dict[str, Callable[[_Function, list[Value]], Value]] = {
    "min": _chosen("min"),
    "max": _chosen("max"),
    "abs": lambda _, values: (f"fabs({values[0][0]})", REAL),
    "int": lambda _, values: (f"(i64)({values[0][0]})", WHOLE),
    "len": lambda _, values: (
        (f"({values[0][0]}).n0", WHOLE)
        if isinstance(values[0][1], ArrayType)
        else (str(len(values[0][1].items)), WHOLE)  # type: ignore[union-attr]
    ),
}


def _dtype(node: ast.Call, usual: str) -> str:
    """Return the dtype in the arguments of a call, or else `usual`."""
    names = [argument.attr for argument in node.args if isinstance(argument, ast.Attribute)]
    return next((_TYPES[name] for name in names if name in _TYPES), usual)


def _unified(first: Type, second: Type) -> Type:
    """Return the type to which values of two types are promoted."""
    if first == second:
        return first
    if not (isinstance(first, str) and isinstance(second, str)):
        raise TranslationError(f"{first} and {second} have no common type in C")
    return max(first, second, key=_PROMOTION.index)


def _loaded(target: ast.expr) -> ast.expr:
    """Return the target of an assignment as an expression that reads its value."""
    return ast.parse(ast.unparse(target), mode="eval").body


def _safe(name: str) -> str:
    """Return the C name of a variable, which is never a keyword."""
    return f"{name}_"
