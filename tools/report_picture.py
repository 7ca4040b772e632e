"""Makes `docs/images/report.png`: a report on a desk, and in the dark on a phone.

    sapopt compare constellation-mid --out results && sapopt report results --out report.html
    python tools/report_picture.py report.html docs/images/report.png

Needs Chromium and its driver.
"""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path

from PIL import Image, ImageDraw

from sapopt.data.files import replacing

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
from webdriver import Browser

STEP = 46
PHONE_WIDTH = 520


def main() -> None:
    page, target = map(Path, sys.argv[1:])
    with tempfile.TemporaryDirectory() as folder:
        desk, phone = Path(folder) / "desk.png", Path(folder) / "phone.png"
        with Browser(1280, 1362) as browser:
            shown(browser, page)
            browser.run("document.querySelector('.player').style.display = 'none'")
            browser.screenshot(desk)
        with Browser(390, 844, dark=True, scale=2.0) as browser:
            shown(browser, page)
            browser.run(
                "document.getElementById('world').scrollIntoView({behavior: 'instant'}); scrollBy(0, -12)"
            )
            time.sleep(0.5)
            browser.screenshot(phone)
        picture = composed(Image.open(desk).convert("RGB"), Image.open(phone).convert("RGB"))
        with replacing(target) as file:
            picture.save(file, format="PNG", optimize=True)


def shown(browser: Browser, page: Path) -> None:
    """Open the page at a step in the middle."""
    browser.open(page)
    browser.wait("return document.documentElement.dataset.ready")
    browser.run(
        "const s = document.getElementById('slider'); s.value = arguments[0]; s.dispatchEvent(new Event('input'))",
        STEP,
    )
    time.sleep(0.5)


def composed(desk: Image.Image, phone: Image.Image) -> Image.Image:
    """Both side by side, the phone with round corners."""
    phone = phone.resize((PHONE_WIDTH, phone.height * PHONE_WIDTH // phone.width), Image.Resampling.LANCZOS)
    both = Image.new("RGB", (desk.width + PHONE_WIDTH + 70, desk.height), "#f4f6f9")
    both.paste(desk, (0, 0))
    x, y = desk.width + 20, (desk.height - phone.height) // 2 + 40
    frame = (x - 8, y - 8, x + phone.width + 8, y + phone.height + 8)
    ImageDraw.Draw(both).rounded_rectangle(frame, 46, fill="#1b2431")
    mask = Image.new("L", (2 * phone.width, 2 * phone.height), 0)
    ImageDraw.Draw(mask).rounded_rectangle((0, 0, mask.width - 1, mask.height - 1), 76, fill=255)
    both.paste(phone, (x, y), mask.resize(phone.size))
    return both.resize((both.width * 3 // 4, both.height * 3 // 4), Image.Resampling.LANCZOS)


if __name__ == "__main__":
    main()
