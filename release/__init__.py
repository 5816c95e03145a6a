"""What a release needs: one version in all manifests, and a check of all that is published. `python -m release`."""
