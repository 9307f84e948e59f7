"""Pages of the report as a browser shows them, with the parts that their script unfolds."""

import base64
import gzip
import re

FOLDED = re.compile(r'<div class="folded">.*?<script type="text/plain">(.*?)</script></div>', re.DOTALL)


def unfolded(page: str) -> str:
    """A page's text with each folded part in its place."""
    return FOLDED.sub(lambda found: gzip.decompress(base64.b64decode(found.group(1))).decode(), page)
