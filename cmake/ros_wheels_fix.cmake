# SPDX-License-Identifier: Apache-2.0
# Included through CMAKE_PROJECT_TOP_LEVEL_INCLUDES.
# The PyPI ROS wheels bake their build machine's Python and NumPy include
# directories into the exported <pkg>__rosidl_generator_py targets.  Once the
# whole list file has run, drop include directories that do not exist here.
# On /opt/ros/jazzy every directory exists, so nothing changes.
function(ros_wheels_drop_missing_includes)
  get_property(targets DIRECTORY PROPERTY IMPORTED_TARGETS)
  foreach(target IN LISTS targets)
    get_target_property(dirs ${target} INTERFACE_INCLUDE_DIRECTORIES)
    if(NOT dirs)
      continue()
    endif()
    set(kept "")
    foreach(dir IN LISTS dirs)
      if(dir MATCHES "\\$<" OR EXISTS "${dir}")
        list(APPEND kept "${dir}")
      endif()
    endforeach()
    set_target_properties(${target} PROPERTIES INTERFACE_INCLUDE_DIRECTORIES "${kept}")
  endforeach()
endfunction()
cmake_language(DEFER CALL ros_wheels_drop_missing_includes)
