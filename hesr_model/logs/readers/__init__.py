"""Files that logs are read from: tables with named columns, MATLAB files and ROS bags."""
