"""Types of the fields of our messages as a table, for the kernels that read encoded messages."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from google.protobuf.descriptor import Descriptor, FieldDescriptor
from numpy.typing import NDArray

from mocapella.schema.wire_kernels import BYTES, FIELDS, FIXED32, FIXED64, MESSAGE, OTHER, TEXT, VARINT

_FORMS: Final = {
    FieldDescriptor.TYPE_BOOL: VARINT,
    FieldDescriptor.TYPE_UINT32: VARINT,
    FieldDescriptor.TYPE_UINT64: VARINT,
    FieldDescriptor.TYPE_INT64: VARINT,
    FieldDescriptor.TYPE_FIXED64: FIXED64,
    FieldDescriptor.TYPE_DOUBLE: FIXED64,
    FieldDescriptor.TYPE_FLOAT: FIXED32,
    FieldDescriptor.TYPE_BYTES: BYTES,
    FieldDescriptor.TYPE_STRING: TEXT,
}
"""Form of each type of fields in our messages."""


def shapes_of(*messages: Any) -> NDArray[np.int8]:
    """Return the forms of all fields (types, `FIELDS`) of some messages, which come first, and of those within them.

    Raises:
        KeyError: a field has a type without an entry in `_FORMS`.
    """
    kinds: list[Descriptor] = [message.DESCRIPTOR for message in messages]
    rows = []
    for kind in kinds:  # grows on the way
        row = np.full(FIELDS, OTHER, np.int8)
        for field in kind.fields:
            if field.type == FieldDescriptor.TYPE_MESSAGE:
                within: Any = field.message_type
                if within not in kinds:
                    kinds.append(within)
                row[field.number] = MESSAGE + kinds.index(within)
            else:
                row[field.number] = _FORMS[field.type]
        rows.append(row)
    return np.array(rows)
