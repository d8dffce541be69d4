#!/bin/sh
# Installs the Debian packages named on the command line that are missing (as root), or names them.
missing=""
if ! command -v dpkg-query >/dev/null 2>&1; then
  echo "setup: not a Debian system; OpenGL 4.3 through EGL and Xvfb must be there (Mesa has both)"
  exit 0
fi
for package in "$@"; do
  dpkg-query -W -f='${Status}' "$package" 2>/dev/null | grep -q "ok installed" || missing="$missing $package"
done
[ -z "$missing" ] && exit 0
if [ "$(id -u)" = 0 ]; then
  echo "setup: installing Debian packages:$missing"
  export DEBIAN_FRONTEND=noninteractive
  apt-get update -qq && apt-get install -y -qq --no-install-recommends $missing >/dev/null && exit 0
  echo "setup: apt-get failed; without these packages the rays are cast in torch and window tests are skipped" >&2
else
  echo "setup: please install:  sudo apt-get install$missing"
  echo "setup: going on without; rays are then cast in torch and the window cannot open"
fi
exit 0
