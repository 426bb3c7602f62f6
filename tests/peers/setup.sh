#!/bin/bash
# Sets up peers from PyPI wheels: ROS 2 Jazzy's rclpy, and the interface packages that no registry
# offers, built from msgs/ into an overlay; ur_rtde, pyrobotiqur and robotiq2f. Nothing needs root.
#
#   tests/peers/setup.sh DIR        makes DIR/venv, DIR/install and DIR/env.sh
#   source DIR/env.sh               then python has rclpy and all message packages
#
# Steps that are done are skipped; a package is rebuilt when its text has changed. Needs python3
# (3.10 to 3.13) with venv, a C++ compiler and about 400 MB.
set -euo pipefail

if [ $# -ne 1 ]; then
  echo "usage: $0 DIR" >&2
  exit 2
fi
repo=$(cd "$(dirname "$0")/../.." && pwd)
mkdir -p "$1"
dir=$(cd "$1" && pwd)
venv=$dir/venv
stamp=$dir/.done
mkdir -p "$stamp"

command -v c++ >/dev/null || { echo "a C++ compiler (c++) is needed: apt install g++" >&2; exit 1; }
[ -x "$venv/bin/pip" ] || python3 -m venv "$venv"

if [ ! -e "$stamp/wheels" ]; then
  "$venv/bin/pip" install -q ros-jazzy-rclpy ros-jazzy-rmw-fastrtps-cpp ros-jazzy-common-interfaces \
    ros-jazzy-test-msgs "rosbags~=0.11" numpy
  touch "$stamp/wheels"
fi

# Clients of the robot's and the gripper's own interfaces.
if [ ! -e "$stamp/robot" ]; then
  "$venv/bin/pip" install -q "ur_rtde==1.6.5" "pyrobotiqur==0.2.2"
  touch "$stamp/robot"
fi

if [ ! -e "$stamp/modbus" ]; then
  "$venv/bin/pip" install -q "robotiq2f==0.2.0"
  touch "$stamp/modbus"
fi

if [ ! -e "$stamp/tools" ]; then
  # The wheels do not declare these dependencies of ament_cmake and rosidl.
  ament="ament-cmake ament-cmake-core ament-cmake-export-definitions ament-cmake-export-dependencies
    ament-cmake-export-include-directories ament-cmake-export-interfaces ament-cmake-export-libraries
    ament-cmake-export-link-flags ament-cmake-export-targets ament-cmake-gen-version-h
    ament-cmake-gmock ament-cmake-gtest ament-cmake-include-directories ament-cmake-libraries
    ament-cmake-pytest ament-cmake-python ament-cmake-ros ament-cmake-target-dependencies
    ament-cmake-test ament-cmake-vendor-package ament-cmake-version ament-index-cpp
    ament-index-python ament-package fastrtps-cmake-module python-cmake-module"
  rosidl="adapter cli cmake core-generators core-runtime default-generators default-runtime
    generator-c generator-cpp generator-py generator-type-description parser pycommon runtime-c
    runtime-cpp typesupport-c typesupport-cpp typesupport-fastrtps-c typesupport-fastrtps-cpp
    typesupport-interface typesupport-introspection-c typesupport-introspection-cpp"
  names=(ros-jazzy-rpyutils)
  for p in $ament; do names+=("ros-jazzy-$p"); done
  for p in $rosidl; do names+=("ros-jazzy-rosidl-$p"); done
  "$venv/bin/pip" install -q "empy<4" "cmake<4" ninja catkin-pkg "setuptools<80" "${names[@]}"
  touch "$stamp/tools"
fi

# The wheels' cmake files name the Python that built them: point them at this one.
site=$("$venv/bin/python" -c 'import sysconfig; print(sysconfig.get_path("purelib"))')
include=$("$venv/bin/python" -c 'import sysconfig; print(sysconfig.get_path("include"))')
{ grep -rlE '/opt/python/cp3' "$venv"/share/*/cmake || true; } | xargs -r sed -i -E \
  "s#/opt/python/cp3[0-9]+-cp3[0-9]+/include/python3\.[0-9]+#$include#g
   s#/opt/python/cp3[0-9]+-cp3[0-9]+/lib/python3\.[0-9]+/site-packages#$site#g"

python_folder=$(basename "$(dirname "$site")")
cat > "$dir/env.sh" <<EOF
export RMW_IMPLEMENTATION=rmw_fastrtps_cpp
export AMENT_PREFIX_PATH=$dir/install:$venv
export PATH=$venv/bin:\$PATH
export PYTHONPATH=$dir/install/lib/$python_folder/site-packages\${PYTHONPATH:+:\$PYTHONPATH}
export LD_LIBRARY_PATH=$dir/install/lib\${LD_LIBRARY_PATH:+:\$LD_LIBRARY_PATH}
export FASTRTPS_DEFAULT_PROFILES_FILE=$repo/config/fastdds_bigbuf.xml
EOF

# Makes an interface package out of the bare field lists: SOURCE NAME DEPENDENCY...
make_package() {
  local source=$1 name=$2 out=$dir/src/$2 dependency files
  shift 2
  rm -rf "$out"
  mkdir -p "$out"
  cp -r "$source"/. "$out"
  files=$(cd "$out" && find . -type f | sort | sed 's#^\./\(.*\)#  "\1"#')
  {
    echo "cmake_minimum_required(VERSION 3.8)"
    echo "project($name)"
    echo "find_package(ament_cmake REQUIRED)"
    echo "find_package(rosidl_default_generators REQUIRED)"
    for dependency in "$@"; do echo "find_package($dependency REQUIRED)"; done
    echo "rosidl_generate_interfaces(\${PROJECT_NAME}"
    echo "$files"
    echo "  DEPENDENCIES $*)"
    echo "ament_package()"
  } > "$out/CMakeLists.txt"
  {
    echo '<?xml version="1.0"?>'
    echo "<package format=\"3\"><name>$name</name><version>0.0.0</version>"
    echo "<description>Field lists for tests</description>"
    echo '<maintainer email="maintainer@example.com">tests</maintainer><license>Apache-2.0</license>'
    echo "<buildtool_depend>ament_cmake</buildtool_depend>"
    echo "<buildtool_depend>rosidl_default_generators</buildtool_depend>"
    for dependency in "$@"; do echo "<depend>$dependency</depend>"; done
    echo "<exec_depend>rosidl_default_runtime</exec_depend>"
    echo "<member_of_group>rosidl_interface_packages</member_of_group>"
    echo "<export><build_type>ament_cmake</build_type></export></package>"
  } > "$out/package.xml"
}

# Builds the package in a folder into the overlay, unless its text is what was built last.
build() {
  local name sum
  name=$(basename "$1")
  sum=$(cd "$1" && find . -type f | sort | xargs sha256sum | sha256sum)
  if [ "$(cat "$stamp/$name" 2>/dev/null)" = "$sum" ]; then return; fi
  echo "building $name"
  (
    set +u
    # shellcheck disable=SC1091
    source "$dir/env.sh"
    cmake -S "$1" -B "$dir/build/$name" -G Ninja -DCMAKE_PREFIX_PATH="$venv;$dir/install" \
      -DCMAKE_INSTALL_PREFIX="$dir/install" -DBUILD_TESTING=OFF -DCMAKE_BUILD_TYPE=Release \
      -DPython3_EXECUTABLE="$venv/bin/python"
    ninja -C "$dir/build/$name" install
  ) > "$dir/build-$name.log" 2>&1 || { tail -n 40 "$dir/build-$name.log" >&2; exit 1; }
  echo "$sum" > "$stamp/$name"
}

interfaces=$repo/msgs/interfaces
make_package "$interfaces/tf2_msgs" tf2_msgs geometry_msgs
make_package "$interfaces/vision_msgs" vision_msgs std_msgs geometry_msgs
make_package "$interfaces/ur_dashboard_msgs" ur_dashboard_msgs action_msgs builtin_interfaces
make_package "$interfaces/ur_msgs" ur_msgs builtin_interfaces geometry_msgs
make_package "$interfaces/controller_manager_msgs" controller_manager_msgs builtin_interfaces
make_package "$interfaces/control_msgs" control_msgs \
  action_msgs builtin_interfaces sensor_msgs std_msgs trajectory_msgs
for name in tf2_msgs vision_msgs ur_dashboard_msgs ur_msgs controller_manager_msgs control_msgs; do
  build "$dir/src/$name"
done
build "$repo/msgs/tdv_msgs"

(
  set +u
  # shellcheck disable=SC1091
  source "$dir/env.sh"
  python -c 'import rtde_control, pyrobotiqur, robotiq2f.robotiq2f'
  python -c 'import rclpy, tdv_msgs.msg, control_msgs.action, vision_msgs.msg, tf2_msgs.msg, ur_dashboard_msgs.msg, \
    ur_msgs.srv, controller_manager_msgs.srv'
)
echo "ready: source $dir/env.sh"
