"""Stand-ins for message classes whose packages are not installed here, for reading raw bytes only.

rclpy subscribes with a type support, which is compiled code of the package. For bytes that are not decoded here, Fast
DDS needs only the name of the type; the rest is borrowed from a type that every installation has (decision 70).
"""

from __future__ import annotations

import ctypes
from importlib.util import find_spec
from typing import Any, cast

from rclpy.utilities import get_rmw_implementation_identifier

from ros2_mcp_bridge.request import OperationError
from ros2_mcp_bridge.ros import interfaces

# A type of unbounded size, because the missing type may be unbounded.
_LENDER = "rcl_interfaces/msg/Log"
_MIDDLEWARE, _SUPPORT = "rmw_fastrtps_cpp", b"rosidl_typesupport_fastrtps_c"
# Distributions that have this package (from Iron on) use the layout below.
_SINCE = "type_description_interfaces"
_HASH_BYTES = 33


_Find = ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.c_void_p, ctypes.c_char_p)
_Hash = ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.c_void_p)


class _TypeSupport(ctypes.Structure):
    """`rosidl_message_type_support_t`, with types for the two functions that are called or made here."""

    _fields_ = (
        ("identifier", ctypes.c_char_p),
        ("data", ctypes.c_void_p),
        ("find", _Find),
        ("hash", _Hash),
        ("description", ctypes.c_void_p),
        ("sources", ctypes.c_void_p),
    )


class _Callbacks(ctypes.Structure):
    """`message_type_support_callbacks_t`: the name of a type, and functions that are never called for raw bytes."""

    _fields_ = (
        ("namespace", ctypes.c_char_p),
        ("name", ctypes.c_char_p),
        ("functions", ctypes.c_void_p * 5),
    )


# Never deleted: Fast DDS keeps pointers into them for as long as there is a participant.
_made: dict[str, tuple[Any, ...]] = {}


def load_to_read(type_name: str) -> Any:
    """Return the class as `interfaces.load` does; for a type that is not installed, a stand-in, usable for
    `rcl.subscription` only.

    Raises `OperationError` of kind `unknown_type` if the middleware does not accept a stand-in.
    """
    if type_name not in _made:
        try:
            return interfaces.load(type_name)
        except OperationError as error:
            if not isinstance(error.__cause__, (ModuleNotFoundError, AttributeError, KeyError)):
                raise
            middleware = get_rmw_implementation_identifier()
            if middleware != _MIDDLEWARE or find_spec(_SINCE) is None:
                problem = (
                    f"{error.message} Only {_MIDDLEWARE}, from Jazzy on, reads it all the same; this is {middleware}."
                )
                raise OperationError("unknown_type", problem, error.hint) from error
        _made[type_name] = _make(type_name)
        interfaces.stood_in.add(type_name)
    return _made[type_name][0]


def _make(type_name: str) -> tuple[Any, ...]:
    package, kind, name = type_name.split("/")
    lender = interfaces.load(_LENDER).__class__._TYPE_SUPPORT
    address = cast("int", _in_capsule(lender, _name_of_capsule(lender)))
    choosing = _TypeSupport.from_address(address)  # of all middlewares: its `find` has those of each
    lent = _TypeSupport.from_address(choosing.find(address, _SUPPORT))
    callbacks = _Callbacks.from_buffer_copy(ctypes.string_at(lent.data, ctypes.sizeof(_Callbacks)))
    callbacks.namespace, callbacks.name = f"{package}::{kind}".encode(), name.encode()
    unknown_hash = ctypes.create_string_buffer(_HASH_BYTES)  # all zero, of which nothing is told to others
    own, front = _TypeSupport.from_buffer_copy(lent), _TypeSupport.from_buffer_copy(choosing)

    def find(_handle: int, wanted: bytes) -> int:
        """Return the type support for an identifier. Fast DDS also requests a description of the type for its own
        tools; it gets that of Log.
        """
        return ctypes.addressof(own) if wanted == _SUPPORT else choosing.find(address, wanted)

    def no_hash(_handle: int) -> int:
        return ctypes.addressof(unknown_hash)

    own.data = ctypes.addressof(callbacks)
    own.hash = front.hash = _Hash(no_hash)
    front.find = _Find(find)
    capsule = _new_capsule(ctypes.addressof(front), None, None)
    metaclass = type(f"Metaclass_{name}", (type,), {"_TYPE_SUPPORT": capsule})
    return metaclass(name, (), {}), front, own, callbacks, unknown_hash


_new_capsule = ctypes.pythonapi.PyCapsule_New
_new_capsule.restype, _new_capsule.argtypes = ctypes.py_object, (ctypes.c_void_p, ctypes.c_char_p, ctypes.c_void_p)
_name_of_capsule = ctypes.pythonapi.PyCapsule_GetName
_name_of_capsule.restype, _name_of_capsule.argtypes = ctypes.c_char_p, (ctypes.py_object,)
_in_capsule = ctypes.pythonapi.PyCapsule_GetPointer
_in_capsule.restype, _in_capsule.argtypes = ctypes.c_void_p, (ctypes.py_object, ctypes.c_char_p)
