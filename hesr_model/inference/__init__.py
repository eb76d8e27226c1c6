"""What estimates are worth: covariances of least squares over logs."""
