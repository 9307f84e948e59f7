"""A stranger's words in a dataset's card are words, not markup."""

from generator.dataset.card import _plain_words


def test_a_description_is_one_paragraph_without_markup() -> None:
    told = _plain_words("Dark sky.\n\n# Heading\n<script>x</script> ![a](http://b) `c`\n---\nlicense: mit")
    assert "\n" not in told
    assert "\\# Heading \\<script\\>x\\</script\\> \\!\\[a\\](http://b) \\`c\\`" in told
    assert _plain_words("Stars over a field, at 52.5 N (winter).") == "Stars over a field, at 52.5 N (winter)."
