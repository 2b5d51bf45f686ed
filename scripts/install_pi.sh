#!/bin/sh
# Install Mocapella on a Raspberry Pi with the 64-bit Raspberry Pi OS, beside the system's picamera2, without a compiler.
# In a clone:  sh scripts/install_pi.sh [FOLDER]      FOLDER is the environment, by default ~/mocapella.
set -eu
here=$(cd "$(dirname "$0")/.." && pwd)
folder=${1:-$HOME/mocapella}
python=${PYTHON:-python3} # of the system: picamera2 is made for no other

if [ "$(getconf LONG_BIT)" != 64 ]; then
    echo "this system has 32 bits, for which there are no packages; install the 64-bit Raspberry Pi OS" >&2
    exit 1
fi
if ! "$python" -c 'import picamera2, ensurepip' 2>/dev/null; then
    sudo apt-get update
    sudo apt-get install -y python3-picamera2 python3-venv
fi
"$python" -m venv --system-site-packages "$folder"
"$folder/bin/pip" install --quiet --only-binary :all: -c "$here/constraints/raspberry-pi.txt" "$here[cameras]"
"$folder/bin/python" -c 'import picamera2, mocapella' # both work in one environment
echo "installed: $folder/bin/mocapella"
echo "measure this machine: $folder/bin/mocapella node markers rendered:thesis/left --fps 90 --set prerender=60 --set timing=900"
