"""Components of a closed loop besides friction and arm, each as an FMU of native C."""
