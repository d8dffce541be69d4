#!/bin/sh
# The pictures of docs/gallery.md: every example, at a size that fits the page. tools/gallery.sh [PYTHON]
set -e
cd "$(dirname "$0")/.."
python=${1:-.venv/bin/python}
mkdir -p docs/gallery
example() {
  name=$(basename examples/"$1"_*.py .py)
  "$python" examples/"$name".py docs/gallery/"$name"."$3" "$2"
}
example 01 384 png
example 02 256 mp4
example 03 192 png
example 04 224 png
example 05 256 png
example 06 256 png
example 07 192 png
example 08 160 png
example 09 96 png
example 10 128 png
rm -f docs/gallery/*.npz docs/gallery/*.json  # the arrays and the motion beside two of the pictures
