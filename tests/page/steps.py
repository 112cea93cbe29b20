"""What people do with the page, step by step; each step begins where the one before it ended."""

import base64
import io
import json
import re
import shlex
import subprocess
import tempfile
import threading
import time
import zipfile
from pathlib import Path

import numpy
import OpenEXR
from axe_playwright_python.sync_playwright import Axe

from farm import wait_for

DROP = """([name, data]) => {
    const bytes = Uint8Array.from(atob(data), (letter) => letter.charCodeAt(0));
    const transfer = new DataTransfer();
    transfer.items.add(new File([bytes], name));
    document.querySelector("main").dispatchEvent(new DragEvent("drop", { dataTransfer: transfer, bubbles: true, cancelable: true }));
}"""
# The job that most steps look at.
JOB = 2
SMALL_PICTURES = "[...document.querySelectorAll('.job img')].every((image) => image.naturalWidth > 0)"
NO_SCROLLING = "document.documentElement.scrollWidth <= document.documentElement.clientWidth"


def button(page, name):
    return page.get_by_role("button", name=name, exact=True)


def show_job(page):
    """The job's state in the list of facts."""
    return page.locator("dl >> nth=0 >> dd >> nth=0").inner_text()


def enter(page, token):
    page.fill("input[name=token]", token)
    page.keyboard.press("Enter")


def sign_in(visit, _):
    """a wrong token is told, a right one is kept where no script reads it"""
    page = visit.page
    visit.go("")
    page.wait_for_selector("form.sign-in")
    check_axe(page)
    enter(page, "phf_wrong")
    page.wait_for_selector("#problem:visible")
    enter(page, visit.farm.artist)
    page.wait_for_selector(".drop")
    assert page.evaluate("document.cookie") == ""
    assert page.locator("#sign-out").inner_text() == "Sign out artist"


def layers_of(farm, number, layers):
    """The picture of a job and some of its layers, as plain numbers."""
    raw = farm.ask(f"jobs/{number}/image.raw?layers={layers}")
    width, height = numpy.frombuffer(raw, "<u4", 2, 8)
    return numpy.frombuffer(raw, "<f4", offset=32).reshape(-1, height, width, 4)


def packed(folder):
    """A folder as a zip archive."""
    archive = io.BytesIO()
    with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED) as file:
        for path in folder.rglob("*"):
            file.write(path, path.relative_to(folder.parent))
    return archive.getvalue()


def drop(page, name, content):
    page.evaluate(DROP, [name, base64.b64encode(content).decode()])


def drop_archive(visit, scenes):
    """an archive that is dropped becomes a job; one without a scene does not"""
    page = visit.page
    drop(page, "meshes.zip", packed(scenes / "cornell-bunny" / "meshes"))
    page.wait_for_selector("#problem:has-text('no scene'):visible")
    drop(page, "cornell-bunny.zip", packed(scenes / "cornell-bunny"))
    page.wait_for_selector("select[name=main]:visible")
    assert page.input_value("select[name=main]") == "scene.xml"
    assert page.input_value("input[name=name]") == "cornell-bunny"
    page.fill("input[name=defines]", "width=96 height=96")
    page.fill("input[name=iterations]", "4")
    page.wait_for_selector(".check p:has-text('no worker is connected')")
    assert button(page, "Render").is_disabled()
    # Without an answer for some seconds the job may begin.
    button(page, "Render").click()
    page.wait_for_url("**/#/jobs/1")
    page.wait_for_selector("dd:has-text('no worker is connected')")


def drop_folder(visit, scenes):
    """a folder becomes a job"""
    page = visit.page
    visit.go("#/")
    page.locator("input[webkitdirectory]").set_input_files(scenes / "still-life")
    page.wait_for_selector("select[name=main]:visible")
    assert page.input_value("input[name=name]") == "still-life"
    page.fill("input[name=defines]", "width=336 height=224" if visit.screenshots else "width=192 height=128")
    page.fill("input[name=iterations]", "3000")
    button(page, "Render").click()
    page.wait_for_url("**/#/jobs/2")
    page.wait_for_selector("dd:has-text('no worker is connected')")


def first_picture(visit, _):
    """the first picture"""
    page, farm = visit.page, visit.farm
    commit = []

    def watch():
        wait_for("the first iteration", lambda: farm.job(JOB)["iterations_done"] > 0)
        commit.append(time.monotonic())

    watcher = threading.Thread(target=watch)
    watcher.start()
    for number in (1, 2):
        farm.work(number)
    page.wait_for_selector(".picture canvas:visible")
    shown = time.monotonic()
    watcher.join()
    after = shown - commit[0]
    print(f"          shown {after:.2f} s after the first node was committed")
    assert after < 15


def pixels(page):
    return page.evaluate("document.querySelector('.picture canvas').toDataURL()")


def sharpen(visit, _):
    """the picture sharpens as nodes arrive"""
    page, farm = visit.page, visit.farm
    first = pixels(page)
    wait_for("another picture", lambda: pixels(page) != first)
    page.wait_for_selector("figcaption:has-text('Iterations a minute'):visible")
    page.wait_for_selector("figcaption:has-text('Noise'):visible")
    page.wait_for_selector("figcaption:has-text('Sigma'):visible")
    page.wait_for_selector("rect.lease.delivered")
    # Pictures of the page are to show more than noise.
    wait_for("iterations", lambda: farm.job(JOB)["iterations_done"] >= (40 if visit.screenshots else 2), 900)


def read_probe(page):
    text = page.locator("#probe").inner_text()
    numbers = re.match(r"x (\d+), y (\d+): radiance (\S+) (\S+) (\S+), luminance (\S+), standard error (\S+)", text)
    assert numbers, text
    return [float(number) for number in numbers.groups()]


def probe(visit, _):
    """paused, the probe says what the EXR has, and the plain numbers are those of the EXR"""
    page, farm = visit.page, visit.farm
    button(page, "Pause").click()
    button(page, "Resume").wait_for()
    wait_for("the end of all leases", lambda: farm.job(JOB)["workers"] == 0 and not farm.job(JOB)["iterations_rendered"] > farm.job(JOB)["iterations_done"])
    done = farm.job(JOB)["iterations_done"]
    page.wait_for_function("done => document.querySelector('.viewer').dataset.iterations === String(done)", arg=done)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "image.exr"
        path.write_bytes(farm.ask(f"jobs/{JOB}/image.exr"))
        with OpenEXR.File(str(path), separate_channels=True) as file:
            exr = numpy.stack([file.channels()[name].pixels for name in ("R", "G", "B", "standard_error")], axis=-1)
    raw = farm.ask(f"jobs/{JOB}/image.raw")
    width, height = numpy.frombuffer(raw, "<u4", 2, 8)
    plain = numpy.frombuffer(raw, "<f4", offset=32).reshape(height, width, 4)
    assert numpy.array_equal(plain.view("u4"), exr.astype("<f4").view("u4"))

    canvas = page.locator(".picture canvas")
    box = canvas.bounding_box()
    for across, down in [(0.5, 0.5), (0.31, 0.77), (0.83, 0.2)]:
        page.mouse.move(box["x"] + across * box["width"], box["y"] + down * box["height"])
        x, y, *found = read_probe(page)
        expected = exr[int(y), int(x)]
        assert abs(x - across * width) <= 1 and abs(y - down * height) <= 1
        assert numpy.allclose([*found[:3], found[4]], expected, rtol=1e-3), (found, expected)
    page.locator(".picture").focus()
    page.keyboard.press("ArrowRight")
    page.keyboard.press("Shift+ArrowUp")
    assert read_probe(page)[:2] == [x + 1, y - 10]
    visit.picture("job")


def compare(visit, _):
    """noise, and two moments beside each other and as a difference"""
    page, farm = visit.page, visit.farm
    plain = pixels(page)
    button(page, "Noise").click()
    assert pixels(page) != plain and page.locator(".legend").is_visible()
    button(page, "Picture").click()
    assert pixels(page) == plain
    page.select_option("label:has-text('Tone curve') select", "filmic")
    assert pixels(page) != plain
    page.select_option("label:has-text('Tone curve') select", "reinhard")
    page.locator("summary:has-text('Compare')").click()
    button(page, "Keep this moment").click()
    button(page, "Resume").click()
    done = farm.job(JOB)["iterations_done"]
    wait_for("more iterations", lambda: farm.job(JOB)["iterations_done"] > done)
    page.select_option("label:has-text('On the right') select", f"moment {done}")
    page.wait_for_selector("p:has-text('root mean squared error')")
    page.locator("label:has-text('Border') input").focus()
    page.keyboard.press("Home")
    page.wait_for_function("document.querySelector('.divide').style.left === '0%'")
    button(page, "Difference").click()
    page.wait_for_selector(".legend:has-text('Right minus left')")
    page.select_option("label:has-text('On the right') select", "")
    page.wait_for_selector(".legend", state="hidden")


def extend(visit, _):
    """extended, it goes on to more iterations"""
    page = visit.page
    page.fill("label:has-text('Iterations') input", "5000")
    button(page, "Extend").click()
    page.wait_for_selector("dd:has-text('of 5000 iterations')")


def heal(visit, _):
    """killed and started again, the coordinator is seen again"""
    page, farm = visit.page, visit.farm
    farm.kill_coordinator()
    page.wait_for_selector("#connection.lost")
    farm.serve()
    page.wait_for_selector("#connection:has-text('live')")
    done = farm.job(JOB)["iterations_done"]
    wait_for("more iterations", lambda: farm.job(JOB)["iterations_done"] > done)
    page.wait_for_function("done => Number(document.querySelector('.viewer').dataset.iterations) > done", arg=done)


def lamps(visit, _):
    """lamps are mixed anew: switched off, coloured, made brighter; the probe tells the sum, and layers are shown"""
    page, farm = visit.page, visit.farm
    spec = farm.job(JOB)["spec"]
    name = f"{spec['name']}, lamps"
    asked = {**spec, "layers": ["lamp:lamp", "normal", "lamp:window"], "iterations": 24 if visit.screenshots else 2, "name": name}
    number = json.loads(farm.ask("jobs", "POST", {key: value for key, value in asked.items() if key != "schedule"}))["id"]
    farm.ask(f"jobs/{number}/priority", "PUT", {"priority": 100})
    farm.ask(f"jobs/{JOB}/pause", "POST", {})
    wait_for("a job with layers", lambda: farm.job(number)["state"] == "done", 900)
    farm.ask(f"jobs/{JOB}/resume", "POST", {})
    visit.go(f"#/jobs/{number}")
    page.wait_for_selector(".picture canvas:visible")
    plain = pixels(page)
    picture, lamp, window = layers_of(farm, number, "1,3")[..., :3].astype("f8")
    x, y = picture.shape[1] // 2, picture.shape[0] // 2

    def probed():
        page.locator(".picture").focus()
        numbers = re.match(r"x (\d+), y (\d+): radiance (\S+) (\S+) (\S+),", page.locator("#probe").inner_text())
        assert [int(number) for number in numbers.groups()[:2]] == [x, y]
        return [float(number) for number in numbers.groups()[2:]]

    page.select_option("label:has-text('Shown') select", "mix")
    page.wait_for_selector(".mixer:visible")
    wait_for("the picture itself, with all lamps as they are", lambda: pixels(page) == plain)
    assert [row.inner_text() for row in page.locator(".lamp:visible label").all()] == ["lamp", "window", "other lamps"]
    page.get_by_label("Colour of window").fill("#ff8040")
    page.get_by_label("Power of window in stops").fill("1.5")
    page.locator(".lamp label:has-text('other lamps') input").click()
    red = numpy.array([((value / 255 + 0.055) / 1.055) ** 2.4 for value in (255, 128, 64)])
    expected = (lamp + window * red * 2**1.5)[y, x]
    wait_for("the mixed picture", lambda: pixels(page) != plain and numpy.allclose(probed(), expected, rtol=2e-3))
    command = page.locator(".command code").inner_text()
    assert command.endswith(f"mix job-{number}.exr --lamp 'window=#ff8040*1.5EV' --lamp '*=0' -o job-{number}-mix.exr"), command
    check_mix(farm, number, command, lamp + window * red * 2**1.5)
    visit.picture("lamps")
    check_axe(page)
    with page.expect_download() as saved:
        button(page, "Save what is shown").click()
    assert Path(saved.value.path()).read_bytes().startswith(b"\x89PNG")
    button(page, "As rendered").click()
    wait_for("the picture itself again", lambda: pixels(page) == plain)
    page.select_option("label:has-text('Shown') select", "2")
    normal = layers_of(farm, number, "2")[1, y, x, :3]

    def tells_the_normal():
        page.locator(".picture").focus()
        told = re.match(r".*: normal (\S+) (\S+) (\S+)$", page.locator("#probe").inner_text())
        return told and numpy.allclose([float(value) for value in told.groups()], normal, rtol=1e-3, atol=1e-6)

    wait_for("the normals", tells_the_normal)
    assert page.locator(".mixer").is_hidden() and page.locator(".compare").is_hidden()
    page.select_option("label:has-text('Shown') select", "picture")
    wait_for("the picture", lambda: pixels(page) == plain)


def check_mix(farm, number, command, expected):
    """The command that the page tells writes what it shows."""
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / f"job-{number}.exr").write_bytes(farm.ask(f"jobs/{number}/image.exr"))
        mix = shlex.split(command.split("&& ", 1)[1])
        assert mix[0] == "photonfarm"
        subprocess.run([farm.programs / mix[0], *mix[1:]], check=True, cwd=folder, stdout=subprocess.DEVNULL)
        with OpenEXR.File(str(Path(folder) / f"job-{number}-mix.exr"), separate_channels=True) as file:
            found = numpy.stack([file.channels()[name].pixels for name in "RGB"], axis=-1)
    assert numpy.allclose(found, expected, rtol=1e-4, atol=1e-6)


def many_jobs(visit, _):
    """more than 100 jobs: older ones on demand, by text and by state, and each by itself"""
    page, farm = visit.page, visit.farm
    spec = farm.job(1)["spec"]
    extra = 104
    for number in range(extra):
        added = json.loads(farm.ask("jobs", "POST", {**spec, "name": f"shot-{number}", "seed": number}))["id"]
        farm.ask(f"jobs/{added}/cancel", "POST", {})
    visit.go("#/")
    page.wait_for_selector(f".job a:has-text('shot-{extra - 1}')")
    assert page.locator(".job").count() == 100
    page.wait_for_selector("dt:has-text('Disk') + dd:has-text('free')")
    page.fill("input[name=find]", "shot-10")
    page.wait_for_selector("p[role=status]:has-text('of the newest 100 jobs')")
    names = page.locator(".job h2").all_inner_texts()
    assert [name.split()[-1] for name in names] == ["shot-103", "shot-102", "shot-101", "shot-100", "shot-10"], names
    page.fill("input[name=find]", "cornell-bunny")
    page.wait_for_function("document.querySelectorAll('.job').length === 0")
    button(page, "Older jobs").click()
    page.wait_for_selector(".job a[href='#/jobs/1']")
    assert page.locator(".job").count() == 1 and button(page, "Older jobs").is_hidden()
    wait_for("its small picture", lambda: page.evaluate("document.querySelector('.job img').naturalWidth") == 96)
    page.select_option("select[name=state]", "cancelled")
    page.wait_for_selector("p[role=status]:has-text('0 of the newest 100 jobs')")
    page.select_option("select[name=state]", "")
    page.fill("input[name=find]", "")
    button(page, "Older jobs").click()
    page.wait_for_selector(".job a[href='#/jobs/1']")
    page.locator(".job a[href='#/jobs/1']").click()
    page.wait_for_selector(".picture canvas:visible")
    assert show_job(page) == "done"
    page.go_back()
    page.wait_for_selector(f".job a:has-text('shot-{extra - 1}')")
    visit.go("#/jobs/9999")
    page.wait_for_selector("p:has-text('There is no such job')")
ODD = b"<scene version='3.0.0'>\n<shape type='rectangle'/>\n<subsurface type='dipole'/></scene>"
BROKEN = b"<scene version='3.0.0'>\n<shape type='shpere'/></scene>"


def look_at_check(page):
    """What is shown of a check is for everybody, and fits a phone."""
    check_axe(page)
    page.set_viewport_size({"width": 375, "height": 812})
    assert page.evaluate(NO_SCROLLING)
    page.set_viewport_size({"width": 1180, "height": 900})


def check_good(visit, scenes):
    """busy workers say what a scene holds before there is a job, and again after a change"""
    page, farm = visit.page, visit.farm
    visit.go("#/")
    jobs = farm.ask("jobs")
    drop(page, "cornell-bunny.zip", packed(scenes / "cornell-bunny"))
    page.wait_for_selector(".check p:has-text('The scene can be rendered: no warnings.')")
    assert button(page, "Render").is_enabled()
    assert "Mitsuba XML" in page.locator(".check dl").inner_text()
    assert page.locator(".check summary:has-text('Settings')").is_visible()
    visit.picture("check")
    page.fill("input[name=defines]", "width=80 height=60")
    page.locator("input[name=defines]").blur()
    page.wait_for_selector(".check dd:has-text('80 × 60 pixels')")
    look_at_check(page)
    button(page, "Leave it").click()
    assert not page.locator(".check").is_visible()
    drop(page, "odd.xml", ODD)
    page.wait_for_selector(".check li:has-text('odd.xml:3: ')")
    assert button(page, "Render").is_enabled()
    button(page, "Leave it").click()
    assert [job["id"] for job in json.loads(farm.ask("jobs"))["jobs"]] == [job["id"] for job in json.loads(jobs)["jobs"]]


def check_broken(visit, _):
    """an error is told with file and line, and there is no job of such a scene"""
    page = visit.page
    drop(page, "broken.xml", BROKEN)
    page.wait_for_selector(".check li:has-text('broken.xml:2: ')")
    assert page.locator("#check-said").inner_text().startswith("The scene cannot be rendered: 1 error.")
    assert button(page, "Render").is_disabled()
    look_at_check(page)
    page.locator("input[name=name]").focus()
    page.keyboard.press("Enter")
    # The parameter is none: the farm is not even asked.
    page.fill("input[name=defines]", "width")
    page.locator("input[name=defines]").blur()
    page.wait_for_selector(".check p:has-text('width gives no parameter a value')")
    assert button(page, "Render").is_disabled()
    button(page, "Leave it").click()
    assert page.evaluate("location.hash") == "#/"


def cancel(visit, _):
    """cancelled, it can be deleted; what has arrived stays"""
    page = visit.page
    visit.go("#/")
    page.wait_for_selector(".job a")
    wait_for("small pictures", lambda: page.evaluate(SMALL_PICTURES))
    visit.picture("jobs")
    visit.go(f"#/jobs/{JOB}")
    button(page, "Cancel").click()
    button(page, "Delete").wait_for()
    assert show_job(page) == "cancelled"
    assert page.locator(".picture canvas").is_visible()


def keyboard(visit, _):
    """the keyboard alone reaches the content, a job and its picture"""
    page = visit.page
    visit.go("#/")
    page.wait_for_selector(".job a")
    page.reload()
    page.wait_for_selector(".job a")
    page.keyboard.press("Tab")
    assert page.evaluate("document.activeElement.textContent") == "Skip to the content"
    page.keyboard.press("Enter")
    for _ in range(20):
        page.keyboard.press("Tab")
        if page.evaluate("document.activeElement.matches('.job a[href$=\"/2\"]')"):
            break
    page.keyboard.press("Enter")
    page.wait_for_url("**/#/jobs/2")
    page.wait_for_selector(".picture canvas:visible")
    for _ in range(30):
        page.keyboard.press("Tab")
        if page.evaluate("document.activeElement.matches('.picture')"):
            break
    page.keyboard.press("ArrowLeft")
    read_probe(page)


def workers(visit, _):
    """an administrator drains a worker, and has it work again"""
    page, farm = visit.page, visit.farm
    page.locator("#sign-out").click()
    page.wait_for_selector("form.sign-in")
    enter(page, farm.admin)
    page.wait_for_selector("#connection:has-text('live')")
    visit.go("#/workers")
    page.wait_for_selector("td:has-text('MiB'), td:has-text('GiB')")
    page.locator("button:has-text('Drain'):visible").first.click()
    page.wait_for_selector("td:text-is('drained'), td:has-text('finishes')")
    visit.picture("workers")
    page.locator("button:has-text('Resume'):visible").click()
    page.wait_for_selector("td:has-text('drained')", state="detached")
    page.wait_for_selector("td:has-text('finishes')", state="detached")


def check_axe(page):
    for scheme in ("light", "dark"):
        page.emulate_media(color_scheme=scheme)
        found = Axe().run(page).response["violations"]
        told = [(one["id"], [node["html"][:200] for node in one["nodes"]]) for one in found]
        assert not told, (scheme, page.url, told)
    page.emulate_media(color_scheme="light")


def everybody(visit, _):
    """axe finds nothing, in light and dark, and a phone scrolls in one direction"""
    page = visit.page
    for place, there, name in [("#/", ".job a", None), ("#/jobs/2", ".picture canvas:visible", "phone"), ("#/workers", "th:has-text('rack-2')", None)]:
        visit.go(place)
        page.wait_for_selector(there)
        check_axe(page)
        page.set_viewport_size({"width": 375, "height": 812})
        assert page.evaluate(NO_SCROLLING), place
        if name:
            page.emulate_media(color_scheme="dark")
            visit.picture(name)
            page.emulate_media(color_scheme="light")
        page.set_viewport_size({"width": 1180, "height": 900})


ALL = [sign_in, drop_archive, drop_folder, first_picture, sharpen, probe, compare, extend, heal, check_good, check_broken, lamps, workers, cancel, keyboard, everybody, many_jobs]
