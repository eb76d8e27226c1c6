"""What every room needs: files, processes, progress, configuration."""
