#!/bin/sh
# Make the first page's links and its picture absolute, for a package index, and name the repository in the metadata.
# The workflow calls it before anything is built; the files are changed where they lie.
set -eu
page=https://github.com/$GITHUB_REPOSITORY/blob/$GITHUB_SHA
picture=https://raw.githubusercontent.com/$GITHUB_REPOSITORY/$GITHUB_SHA
sed -e "s|](\(docs/[^)]*\.png\))|]($picture/\1)|" \
    -e "s|](\(docs/[^)]*\.md\))|]($page/\1)|g" \
    -e "s|](CITATION.cff)|]($page/CITATION.cff)|" README.md > README.absolute
mv README.absolute README.md
sed -e "s|^\[project.urls\]$|&\nRepository = \"https://github.com/$GITHUB_REPOSITORY\"|" pyproject.toml > pyproject.absolute
mv pyproject.absolute pyproject.toml
