"""Image processing: detect markers, tags, boards, silhouettes and arms in images."""
