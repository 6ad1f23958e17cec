"""The live page as an operator uses it: a real browser on a running daemon.

Start, watch, reload in the middle, stop, read the verdict. The browser is Debian's chromium through its chromedriver.
"""

import contextlib
import json
import os
import pathlib
import re
import subprocess
import urllib.request

import pytest
from selenium import webdriver
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys
from selenium.webdriver.support.ui import WebDriverWait

ROOT = pathlib.Path(__file__).resolve().parents[2]
PLUMB = ROOT / os.environ.get("PLUMB", "target/debug/plumb")
PATIENCE_S = 60


def camera_table(name, recording):
    """The configuration of a camera that replays a recording as fast as a camera would give it."""
    path = ROOT / "recordings" / recording
    return (
        f'[[camera]]\nname = "{name}"\n'
        f'source = {{ kind = "recording", path = "{path}", pace = "recorded", repeat = true }}\n'
    )


@contextlib.contextmanager
def served(folder, tables):
    """A running daemon; its address."""
    config = folder / "plumb.toml"
    config.write_text(f'[store]\npath = "{folder}/store"\n{tables}')
    command = [PLUMB, "serve", "--config", config, "--listen", "127.0.0.1:0"]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, env={**os.environ, "RUST_LOG": "info"})
    address = None
    for line in process.stderr:
        found = re.search(r"http://[\d.:]+", line)
        if found:
            address = found.group()
            break
    assert address, "the daemon did not say where it listens"
    yield address
    process.terminate()
    # Its log is read on, or it would wait for its reader.
    process.communicate(timeout=30)


@pytest.fixture
def daemon(tmp_path):
    """A daemon that replays the bundled walk."""
    with served(tmp_path, camera_table("front", "walk.mcap")) as address:
        yield address


@pytest.fixture
def approving_daemon(tmp_path):
    """The same, where a person approves."""
    with served(tmp_path, camera_table("front", "walk.mcap") + "[calibration]\nauto_approve = false\n") as address:
        yield address


@pytest.fixture
def rig_daemon(tmp_path):
    """A daemon with a rig of two cameras."""
    cameras = camera_table("left", "rig-left.mcap") + camera_table("right", "rig-right.mcap")
    with served(tmp_path, f'{cameras}[[rig]]\nname = "head"\ncameras = ["left", "right"]\n') as address:
        yield address


@pytest.fixture
def browser():
    options = webdriver.ChromeOptions()
    options.binary_location = "/usr/bin/chromium"
    for argument in ("--headless=new", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage", "--window-size=1300,1000"):
        options.add_argument(argument)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    driver = webdriver.Chrome(options=options, service=webdriver.ChromeService("/usr/bin/chromedriver"))
    yield driver
    errors = [entry["message"] for entry in driver.get_log("browser") if entry["level"] == "SEVERE"]
    driver.quit()
    assert errors == []


def ask(address, path, method="GET", document=None):
    body = json.dumps(document).encode() if document else None
    request = urllib.request.Request(address + path, body, {"Content-Type": "application/json"}, method=method)
    with urllib.request.urlopen(request) as response:
        text = response.read()
        return json.loads(text) if text else None


def wait(browser, condition):
    return WebDriverWait(browser, PATIENCE_S, poll_frequency=0.1).until(condition)


def shown(browser, name):
    wait(browser, lambda b: b.find_element(By.ID, name).is_displayed())
    return browser.find_element(By.ID, name)


def number(browser, name):
    found = re.match(r"[\d.]+", browser.find_element(By.ID, name).text)
    return float(found.group()) if found else None


def start_session(browser):
    for name, value in (("cols", "9"), ("rows", "6"), ("square", "25")):
        field = shown(browser, name)
        field.clear()
        field.send_keys(value)
    shown(browser, "start").click()
    shown(browser, "stop")


def test_an_operator_calibrates_and_reloads_in_the_middle(daemon, browser):
    browser.get(daemon)
    image = browser.find_element(By.ID, "live-image")
    wait(browser, lambda b: b.execute_script("return arguments[0].naturalWidth", image) == 640)
    wait(browser, lambda b: "streaming" in b.find_element(By.ID, "state").text)

    start_session(browser)
    wait(browser, lambda b: number(b, "n-views") >= 4)
    assert shown(browser, "guidance").text
    wait(browser, lambda b: b.find_elements(By.CSS_SELECTOR, "#overlay .cell"))
    wait(browser, lambda b: len(b.find_elements(By.CSS_SELECTOR, "#views li")) >= 4)
    wait(browser, lambda b: "Not kept" in b.find_element(By.ID, "last").text)
    session = ask(daemon, "/v1/sessions")["sessions"][0]

    browser.refresh()
    shown(browser, "stop")
    assert not browser.find_element(By.ID, "start-form").is_displayed()
    wait(browser, lambda b: number(b, "n-views") >= max(10, session["views_kept"]))
    assert number(browser, "n-rms") is not None and number(browser, "n-uncertainty") is not None
    sessions = ask(daemon, "/v1/sessions")["sessions"]
    assert [one["id"] for one in sessions] == [session["id"]], "a reload goes on with the session that runs"

    shown(browser, "stop").click()
    verdict = shown(browser, "verdict").text
    calibration = ask(daemon, "/v1/cameras/front/calibrations")["calibrations"][0]
    assert verdict.split(":")[0].split(",")[0].lower() == calibration["verdict"]["grade"]
    reasons = [item.text for item in browser.find_elements(By.CSS_SELECTOR, "#reasons li")]
    assert [reason.lower() for reason in reasons] == [reason.lower() for reason in calibration["verdict"]["reasons"]]
    heat = browser.find_element(By.ID, "heat")
    wait(browser, lambda b: b.execute_script("return arguments[0].naturalWidth", heat) > 0)
    links = [link.text for link in browser.find_elements(By.CSS_SELECTOR, "#downloads a")]
    assert links == ["json", "ros", "opencv", "kalibr", "mrcal", "colmap"]
    assert len(browser.find_elements(By.CSS_SELECTOR, "#history tbody tr")) == 1

    browser.refresh()
    assert shown(browser, "verdict").text == verdict


def test_the_keyboard_is_enough_and_errors_are_shown(daemon, browser):
    browser.get(daemon)
    shown(browser, "cols").send_keys("7", Keys.TAB, "4", Keys.TAB, "25", Keys.ENTER)
    stop = shown(browser, "stop")
    wait(browser, lambda b: b.switch_to.active_element == stop)
    # No board of this size is ever seen.
    wait(browser, lambda b: "Not kept" in b.find_element(By.ID, "last").text)
    browser.switch_to.active_element.send_keys(Keys.ENTER)
    wait(browser, lambda b: b.find_element(By.ID, "session-title").text == "No calibration")
    assert shown(browser, "session-reason").text
    assert browser.find_element(By.ID, "start-form").is_displayed(), "one can begin again at once"


def test_a_camera_in_a_rigs_session_names_the_rig_until_it_is_free(rig_daemon, browser):
    target = {"kind": "chessboard", "cols": 8, "rows": 6, "square_m": 0.03}
    session = ask(rig_daemon, "/v1/rigs/head/sessions", "POST", {"target": target})["id"]
    browser.get(f"{rig_daemon}/#left")
    wait(browser, lambda b: "session of the rig head" in b.find_element(By.ID, "loading").text)
    assert not browser.find_element(By.ID, "session").is_displayed(), "its buttons act on the whole rig"
    assert not browser.find_element(By.ID, "start-form").is_displayed()

    ask(rig_daemon, f"/v1/sessions/{session}", "DELETE")
    shown(browser, "start-form")
    assert not browser.find_element(By.ID, "loading").is_displayed()
    assert not browser.find_element(By.ID, "session").is_displayed()


def test_a_deleted_result_leaves_a_way_to_begin_again(approving_daemon, browser):
    daemon = approving_daemon
    browser.get(daemon)
    start_session(browser)
    wait(browser, lambda b: number(b, "n-views") >= 4)
    shown(browser, "stop").click()
    shown(browser, "verdict")
    calibration = ask(daemon, "/v1/cameras/front/calibrations")["calibrations"][0]["id"]
    ask(daemon, f"/v1/calibrations/{calibration}", "DELETE")

    browser.refresh()
    assert "calibration was deleted" in shown(browser, "start-error").text
    assert browser.find_element(By.ID, "start").is_displayed()
    assert not browser.find_element(By.ID, "result").is_displayed()


def test_the_board_in_view_fills_the_form(daemon, browser):
    browser.get(daemon)
    said = browser.find_element(By.ID, "seen-target")

    def named(_):
        # The board is not whole in every frame.
        shown(browser, "detect-target").click()
        wait(browser, lambda b: b.find_element(By.ID, "detect-target").is_enabled())
        return "9x6" in said.text

    wait(browser, named)
    values = [browser.find_element(By.ID, name).get_attribute("value") for name in ("kind", "cols", "rows")]
    assert values == ["chessboard", "9", "6"]
    assert browser.switch_to.active_element == browser.find_element(By.ID, "square"), "what no image shows is asked for"


def test_a_narrow_screen_shows_everything_without_scrolling_sideways(daemon, browser):
    browser.execute_cdp_cmd(
        "Emulation.setDeviceMetricsOverride", {"width": 360, "height": 740, "deviceScaleFactor": 2, "mobile": True}
    )
    browser.get(daemon)
    start_session(browser)
    wait(browser, lambda b: len(b.find_elements(By.CSS_SELECTOR, "#views li")) >= 2)
    assert browser.execute_script("return document.documentElement.scrollWidth") <= 360
