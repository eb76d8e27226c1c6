"""Many runs of one system of FMUs: designed, done on all cores or a cluster, kept and summed up."""
