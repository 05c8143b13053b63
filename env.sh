# SPDX-License-Identifier: Apache-2.0
# Source this (bash, sh or zsh, from anywhere) for the environment of `make setup`: `uav-vslam`, `python`, messages.
# It sets each path itself, because colcon's own setup.bash is many times slower and doesn't know the PyPI wheels.

# Path of this file: bash and zsh provide it; in plain sh, search the shell's open files for it.
_uav_root=
if [ -n "${BASH_SOURCE:-}" ]; then
  _uav_root=$BASH_SOURCE
elif [ -n "${ZSH_VERSION:-}" ]; then
  eval '_uav_root=${(%):-%x}'
else
  for _uav_path in /proc/$$/fd/*; do
    _uav_path=$(readlink "$_uav_path") || continue
    case $_uav_path in */env.sh) _uav_root=$_uav_path ;; esac
  done
fi
_uav_root=$(cd "$(dirname "${_uav_root:-./env.sh}")" && pwd)

_uav_prepend() { # _uav_prepend NAME FOLDER: put an existing FOLDER first in the path variable NAME, once
  [ -d "$2" ] || return 0
  eval "_uav_path=\${$1:-}"
  case ":$_uav_path:" in
    *":$2:"*) ;;
    *) export "$1=$2${_uav_path:+:$_uav_path}" ;;
  esac
}

if [ ! -r "$_uav_root/install/stamp" ] || [ ! -r "$_uav_root/.venv/ros" ]; then
  echo "env.sh: $_uav_root is not set up; run make setup there" >&2
  unset _uav_root _uav_path
  unset -f _uav_prepend
  return 1
fi

if [ "$(cat "$_uav_root/.venv/ros")" = jazzy ]; then
  [ -n "${ROS_DISTRO:-}" ] || . /opt/ros/jazzy/setup.sh
else
  # The wheels restart Python to set the first variable, unless the second marks that as done: set both or neither.
  for _uav_folder in "$_uav_root"/.venv/lib/python3.*/site-packages/ros_*.libs "$_uav_root/.venv/lib"; do
    _uav_prepend LD_LIBRARY_PATH "$_uav_folder"
  done
  export _ROS_WHEELS_BOOTSTRAP_COMPLETE=1
  _uav_prepend AMENT_PREFIX_PATH "$_uav_root/.venv"
fi

_uav_prepend PATH "$_uav_root/.venv/bin"
for _uav_folder in tf2_msgs uav_vslam_msgs uav_vslam; do
  _uav_folder=$_uav_root/install/$_uav_folder
  [ -d "$_uav_folder" ] || continue
  _uav_prepend AMENT_PREFIX_PATH "$_uav_folder"
  _uav_prepend PATH "$_uav_folder/bin"
  _uav_prepend LD_LIBRARY_PATH "$_uav_folder/lib"
  for _uav_site in "$_uav_folder"/lib/python3.*/site-packages; do
    _uav_prepend PYTHONPATH "$_uav_site"
  done
done
_uav_prepend PYTHONPATH "$_uav_root/build/uav_vslam" # metadata of the installed programs
_uav_prepend PYTHONPATH "$_uav_root"                 # the sources: edits take effect at once

# Images pass between the processes of one host through shared memory (our nodes without images: uav_vslam/ros/transport.py).
case ${FASTRTPS_DEFAULT_PROFILES_FILE:-} in
  "" | */config/dds/images.xml) export FASTRTPS_DEFAULT_PROFILES_FILE="$_uav_root/config/dds/images.xml" ;; # or of another clone
esac
export ROS_AUTOMATIC_DISCOVERY_RANGE="${ROS_AUTOMATIC_DISCOVERY_RANGE:-LOCALHOST}"
# One thread per process: results repeat, and processes don't fight for cores.
export OMP_NUM_THREADS="${OMP_NUM_THREADS:-1}" OPENBLAS_NUM_THREADS="${OPENBLAS_NUM_THREADS:-1}"

unset _uav_root _uav_path _uav_folder _uav_site
unset -f _uav_prepend
