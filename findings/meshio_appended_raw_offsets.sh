#!/bin/bash
# library: meshio
# version: 5.3.5
# expected: a .vtu file with compressed arrays in raw appended data is read, whatever the arrays hold
# seen: ReadError, or one array in the place of another, depending on the values. meshio finds each array by its offset and
#       writes the offset in its own base64 copy there; an array that begins where an earlier one was put is taken for that one
# A few bytes more or less in any array before it, and the same file is read.
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q meshio==5.3.5 numpy==2.4.6
cd "$work"
cat > look.py <<'PY'
import zlib
import meshio
import numpy as np

def block(values, flushed):
    press = zlib.compressobj(9)
    stream = press.compress(values.tobytes())
    if flushed:  # an empty block within the stream, which changes its length alone
        stream += press.flush(zlib.Z_SYNC_FLUSH)
    stream += press.flush()
    return np.array([1, values.nbytes, 0, len(stream)], "<u8").tobytes() + stream

def write(path, fields, flushed=False):
    n = len(fields["a"])
    types = {"f": "Float64", "i": "Int64", "u": "UInt8"}
    data, text, place = b"", "", []
    sections = [("PointData", fields), ("Points", {"Points": np.zeros((n, 3))}), ("Cells", {
        "connectivity": np.arange(n), "offsets": np.arange(1, n + 1), "types": np.ones(n, np.uint8)})]
    for section, arrays in sections:
        text += f"<{section}>\n"
        for name, values in arrays.items():
            size = ' NumberOfComponents="3"' if values.ndim == 2 else ""
            text += (f'<DataArray type="{types[values.dtype.kind]}" Name="{name}"{size} format="appended" '
                     f'offset="{len(data)}"/>\n')
            place.append(len(data))
            data += block(values, flushed and name == "a")
        text += f"</{section}>\n"
    head = ('<?xml version="1.0"?>\n<VTKFile type="UnstructuredGrid" version="1.0" byte_order="LittleEndian" '
            'header_type="UInt64" compressor="vtkZLibDataCompressor">\n<UnstructuredGrid>\n'
            f'<Piece NumberOfPoints="{n}" NumberOfCells="{n}">\n{text}</Piece>\n</UnstructuredGrid>\n'
            '<AppendedData encoding="raw">\n_')
    with open(path, "wb") as file:
        file.write(head.encode() + data + b"\n</AppendedData>\n</VTKFile>\n")
    return place

def right(path, fields):
    try:
        seen = meshio.vtu.read(path).point_data
    except meshio.ReadError as error:
        return f"ReadError {error}"
    return "read" if all(np.array_equal(seen[name], values) for name, values in fields.items()) else "other values"

random = np.random.default_rng(1)
n, seen = 64, []
second = 4 * -(-(8 + 8 * n) // 3)  # where meshio puts the second array
for trial in range(2000):
    fields = {"a": np.zeros(n), "b": random.random(n), "c": np.zeros(n), "d": np.ones(n)}
    fields["c"][: 1 + trial % 8] = random.random(1 + trial % 8)
    if second in write("a.vtu", fields):
        seen.append((right("a.vtu", fields), write("b.vtu", fields, True) and right("b.vtu", fields)))
print(f"meshio {meshio.__version__}: {len(seen)} of 2000 files have an array at byte {second}; as written, and with a few bytes more in the first array:")
print(sorted(set(seen)))
assert seen and all(first != "read" and other == "read" for first, other in seen), "the behaviour has changed"
PY
"$work/venv/bin/python" look.py
