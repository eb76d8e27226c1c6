"""Readers of log files: tables with named columns, MATLAB files and ROS bags."""
