#!/bin/sh
# The viewer of exported web pages, bundled once: tools/web/viewer.js with three.js into avatarrex/export/web/viewer.min.js, and
# three's licence beside it. Needs npm; whoever installs or runs the studio does not.
set -eu
cd "$(dirname "$0")/.."
three=0.187.0 esbuild=0.28.2
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
npm install --silent --no-save --prefix "$work" "three@$three" "esbuild@$esbuild"
cp tools/web/viewer.js "$work/"
"$work/node_modules/.bin/esbuild" "$work/viewer.js" --bundle --minify --format=esm --target=es2022 --legal-comments=none \
  --charset=ascii --banner:js="/* three.js $three, MIT licence, Copyright 2010-2026 three.js authors: THREE_LICENSE */" \
  --outfile=avatarrex/export/web/viewer.min.js
cp "$work/node_modules/three/LICENSE" avatarrex/export/web/THREE_LICENSE
