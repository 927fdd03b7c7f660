"""Steps of a user on the page, by mouse and keys: from a recording to its report."""

from collections.abc import Callable
from typing import Any

from tests.own_press import FRAME_SHAPE, FRAMES, HOLE_RADIUS_MM, RATE, TRIGGER_FRAME, VIEWS

LAST = FRAMES - 1
_LAYER = "label.toggle:has-text('{}') input"
_HELD = 4  # px
Seen = Callable[[str], None]


def drag(page: Any, start: tuple[float, float], end: tuple[float, float], frame_width: int) -> None:
    """Drag the mouse from one position to another, both (x, y) in px of the frame."""
    page.locator("#picture").scroll_into_view_if_needed()
    box = page.locator("#picture").bounding_box()
    scale = box["width"] / frame_width
    (x0, y0), (x1, y1) = ((box["x"] + x * scale, box["y"] + y * scale) for x, y in (start, end))
    page.mouse.move(x0, y0)
    page.mouse.down()
    page.mouse.move((x0 + x1) / 2, (y0 + y1) / 2)
    page.mouse.move(x1, y1)
    page.mouse.up()


def fill(page: Any, key: str, value: str) -> None:
    """Enter the value of a key of the scene in its field."""
    field = page.locator(f'[data-key="{key}"]')
    page.evaluate("element => { element.closest('details').open = true; }", field.element_handle())
    box = field.locator("input").first
    box.fill(value)
    box.press("Enter")


def browse(page: Any, key: str, file: str) -> None:
    """Choose a file for a key in its dialog: go up one folder, back into the folder of the scene, and click the
    file.
    """
    field = page.locator(f'[data-key="{key}"]')
    page.evaluate("element => { element.closest('details').open = true; }", field.element_handle())
    page.click(f'[aria-label="browse {key}"]')
    # The dialog opens empty and names its folder when the server has answered.
    page.wait_for_selector(f"dialog button:text-is('{file}')")
    folder = page.text_content("dialog p").rpartition("/")[2]
    page.click("dialog button:has-text('folder above')")
    page.click(f"dialog button:text-is('{folder}/')")
    page.click(f"dialog button:text-is('{file}')")
    page.wait_for_selector("dialog", state="detached")


def choose(page: Any, key: str, column: str) -> None:
    """Choose a column of the force file in the menu of its key."""
    field = page.locator(f'[data-key="{key}"]')
    page.evaluate("element => { element.closest('details').open = true; }", field.element_handle())
    page.wait_for_selector(f'[aria-label="{key}"] option:text-is("{column}")', state="attached")
    page.select_option(f'[aria-label="{key}"]', label=column)


def set_value(page: Any, selector: str, value: float) -> None:
    """Set the value of a field, as if it were typed or dragged."""
    page.locator(selector).evaluate(
        f"element => {{ element.value = {value}; element.dispatchEvent(new Event('input')); }}"
    )


def show_frame(page: Any, frame: int) -> None:
    """Show a frame by moving the slider."""
    set_value(page, "#frame", frame)
    page.wait_for_selector(f"#picture[data-frame='{frame}']")


def settled(page: Any) -> None:
    """Wait until the page shows contact, points and forces of a complete scene."""
    page.wait_for_selector("#picture[data-mask=true]")
    page.wait_for_selector("#legend:has-text('points, seeded in frame')")
    page.wait_for_function("() => !document.querySelector('#panel').textContent.includes('Loading')")


def walk(page: Any, seen: Seen) -> None:
    """Walk from the page opened at the recording of `write_raw_press` to the report.

    `seen` is called with the name of each step that leaves something to look at.
    """
    page.wait_for_selector("#problems")
    show_frame(page, LAST)
    seen("opened")

    # The views are the halves of the frame at first: drag their corners to the bright areas.
    height, width = FRAME_SHAPE
    half = width / 2
    for view, (left, right) in (("topography", (0, half)), ("contact", (half, width))):
        (top, bottom), (first, end) = VIEWS[view].rows, VIEWS[view].columns
        # The mouse takes hold a few px inside the corner.
        drag(page, (left + _HELD, _HELD), (first + _HELD, top + _HELD), width)
        drag(page, (right - _HELD, height - _HELD), (end - _HELD, bottom - _HELD), width)
    page.wait_for_function("() => !document.getElementById('text').textContent.includes('[0, ')")
    fill(page, "recording.frame_rate", f"{RATE:g}")
    fill(page, "recording.trigger_frame", str(TRIGGER_FRAME))
    fill(page, "background.frames", "empty.tif")
    fill(page, "background.dark", "dark.tif")
    seen("views")

    page.click("#calibration summary")
    for name, value in {"ring": "ring.tif", "target": "target.tif", "background": "empty.tif"}.items():
        page.fill(f'[aria-label="calibrate {name}"]', value)
    page.fill('[aria-label="calibrate hole_radius_mm"]', str(HOLE_RADIUS_MM))
    page.click("#calibrate")
    page.wait_for_selector("#calibration-picture", state="visible")
    page.wait_for_function("() => document.getElementById('calibration-picture').naturalWidth > 100")
    settled(page)
    seen("calibrated")
    page.click("#calibration summary")

    # Look at the overlay: ridges of one view should fall on those of the other.
    page.check(_LAYER.format("Check calibration: overlay the views"))
    page.uncheck(_LAYER.format("points"))
    page.uncheck("label.toggle:text-is('contact') input")
    page.wait_for_selector("#picture[data-mask=false]")
    seen("overlay")
    page.uncheck(_LAYER.format("Check calibration: overlay the views"))
    page.check(_LAYER.format("points"))
    page.check("label.toggle:text-is('contact') input")

    browse(page, "forces.file", "forces.csv")
    choose(page, "forces.normal", "normal_force")
    choose(page, "forces.tangential", "tangential_force")
    choose(page, "forces.trigger", "trigger")
    fill(page, "forces.trigger_level", "2.5")
    page.wait_for_selector("#error:has-text('sign')")  # the force is negative while the finger presses
    page.wait_for_selector("#setup-status:has-text('Cannot process: see the error above')")
    page.click('[aria-label="forces.sign 1"]')
    page.wait_for_selector("#courses:not([hidden])")
    settled(page)

    # Set a threshold by hand, and return to the threshold that is found.
    set_value(page, '[aria-label="contact.threshold number"]', 0.3)
    page.wait_for_function("() => document.querySelector('#panel dd').textContent.trim() == '0.3'")
    page.select_option('[aria-label="contact.threshold"]', "reference_frame")
    page.wait_for_function("() => document.querySelector('#panel dd').textContent.trim() != '0.3'")
    settled(page)

    page.click("#write")
    page.wait_for_selector(".good:has-text('has these settings')")
    seen("written")
    page.click("#process")
    page.wait_for_selector("#tab-results.on")
    page.wait_for_selector(f"#picture[data-frame='{LAST}'][data-mask=true]")
    seen("result")

    page.click("#report")
    page.wait_for_selector("#report-link a")
    with page.context.expect_page() as opening:
        page.click("#report-link a")
    opening.value.wait_for_selector("h1")
    seen("report")
