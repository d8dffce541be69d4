#!/bin/sh
# Installs with pip as constraints.txt says and tells, in a line each, what is downloaded that is larger than 1 MB and when it is installed:
#   tools/pip_install.sh PYTHON WHAT …
python=$1
shift
said=$(mktemp)
trap 'rm -f "$said"' EXIT
{ "$python" -m pip install --progress-bar off --constraint constraints.txt "$@" 2>&1 || echo "pip failed"; } | tee "$said" |
  sed -u -n -E 's/^ *(Downloading|Using cached) (.*\/)?([A-Za-z0-9_.]+)-[0-9].*(\([0-9.]+ [MG]B\)).*/setup:   \3 \4/p
    s/^Installing collected packages.*/setup:   unpacking/p'
if [ "$(tail -n 1 "$said")" = "pip failed" ]; then
  cat "$said" >&2
  exit 1
fi
