# SPDX-License-Identifier: GPL-3.0-or-later
"""The readings of many captures in one Parquet file, with a column that names the capture."""

import json

from gnuradio.wiforce.io.optional import optional_module
from gnuradio.wiforce.io.text.textfile import check_output, replacing

CAPTURE = "capture"
_METADATA = b"wiforce:captures"


def check_whole(path):
    """Refuse a path that cannot be written to, and a missing pyarrow, before captures are read."""
    optional_module("pyarrow", "--output")
    check_output(path)


def join_parts(path, parts):
    """Write one file from those of the captures; it appears when it is complete.

    Returns int: number of readings. The file's metadata hold those of each capture under
    ``wiforce:captures``, as JSON.

    ``parts``: name of a capture and the Parquet file of its readings.
    """
    import pyarrow
    from pyarrow import parquet

    rows, described = 0, {}
    # A capture of a surface has more columns than one without.
    schemas = [parquet.read_schema(part).remove_metadata() for _, part in parts]
    plain = pyarrow.unify_schemas(schemas) if schemas else None
    with replacing(path) as partial:
        writer = None
        for name, part in parts:
            with parquet.ParquetFile(part, page_checksum_verification=True) as file:
                described[name] = _own_metadata(file.schema_arrow)
                field = pyarrow.field(CAPTURE, pyarrow.dictionary(pyarrow.int32(), pyarrow.utf8()))
                if writer is None:
                    schema = plain.insert(0, field)
                    writer = parquet.ParquetWriter(
                        partial, schema, compression="zstd", write_page_checksum=True
                    )
                for batch in file.iter_batches():
                    names = pyarrow.array([name] * len(batch)).cast(field.type)
                    held = dict(zip(batch.schema.names, batch.columns, strict=True))
                    nothing = [None] * len(batch)
                    own = [held.get(f.name, pyarrow.array(nothing, f.type)) for f in plain]
                    columns = [names, *own]
                    writer.write_batch(pyarrow.record_batch(columns, schema=schema))
                    rows += len(batch)
        if writer is not None:
            writer.add_key_value_metadata({_METADATA.decode(): json.dumps(described)})
            writer.close()
    return rows


def _own_metadata(schema):
    """What a capture's file says of its scene, sensors and version."""
    found = schema.metadata or {}
    return {
        key.decode(): value.decode() for key, value in found.items() if key.startswith(b"wiforce:")
    }
