"""Components of a closed loop other than friction and arm, each as an FMU of native C."""
