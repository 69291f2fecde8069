#!/usr/bin/env python3
"""Writes PNGs of a report.html: chosen frames, the whole page or single views.

    screenshot.py out/demo/report.html --out docs/images --frames 20 60 99 --views enhanced coarse
    screenshot.py out/demo/report.html --out docs/images --frames 99 --views page --size 1920x1080 --dark
"""

import argparse
import pathlib
import sys

from browser import Browser, BrowserError


def parse_arguments():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("report", type=pathlib.Path)
    parser.add_argument("--out", type=pathlib.Path, default=pathlib.Path("."), help="folder of the PNGs")
    parser.add_argument("--frames", type=int, nargs="+", help="frame indices; negative ones count from the end")
    parser.add_argument(
        "--views", nargs="+", default=["page"], help="page (everything), views (all views), coarse, enhanced, reference, map"
    )
    parser.add_argument("--size", default="1280x800", help="width x height of the picture")
    parser.add_argument("--scale", type=float, default=1, help="device pixels per pixel")
    parser.add_argument("--azimuth", type=float, default=31.5, help="camera, degrees")
    parser.add_argument("--elevation", type=float, default=17.2, help="camera, degrees")
    parser.add_argument("--zoom", type=float, default=1)
    parser.add_argument("--map", choices=["enhanced", "upsampled", "detail"], help="what the map shows")
    parser.add_argument("--bare", action="store_true", help="views without labels and frame")
    parser.add_argument("--wireframe", action="store_true")
    parser.add_argument("--dark", action="store_true")
    parser.add_argument("--quick", action="store_true", help="simpler light, many times faster without a GPU")
    parser.add_argument("--prefix", default="", help="start of the file names")
    return parser.parse_args()


BARE_STYLE = """
const style = document.createElement('style');
style.textContent = 'header, footer, #side { display: none !important } main { padding: 0 !important; display: block !important }' +
  '#views { height: 100vh } body { display: block !important }' +
  '.view { border-radius: 0 !important; box-shadow: none !important }' + (arguments[0] ? '.overlay { display: none !important }' : '');
document.head.append(style);
"""


def main():
    options = parse_arguments()
    width, height = (int(part) for part in options.size.split("x"))
    options.out.mkdir(parents=True, exist_ok=True)
    with Browser(width, height, dark=options.dark, scale=options.scale) as browser:
        browser.open(options.report.resolve().as_uri() + ("#still" if options.quick else "#still,best"))
        browser.wait("window.pleatReport && (pleatReport.ready || pleatReport.error)")
        error = browser.run("return pleatReport.error")
        if error:
            raise BrowserError(error)
        count = browser.run("return pleatReport.frameCount")
        known = browser.run("return pleatReport.views")
        if options.map:
            browser.run("pleatReport.map = arguments[0]", options.map)
        browser.run("pleatReport.wireframe = arguments[0]", options.wireframe)
        if "page" not in options.views:
            browser.run(BARE_STYLE, options.bare)
        for view in options.views:
            if view not in ("page", "views") and view not in known:
                print(f"{options.report}: no view {view}, it has {', '.join(known)}", file=sys.stderr)
                return 2
            browser.run("pleatReport.solo = arguments[0]", None if view in ("page", "views") else view)
            # The camera's distance depends on the shape of the panel.
            browser.run(
                "pleatReport.setCamera(arguments[0] * Math.PI / 180, arguments[1] * Math.PI / 180, arguments[2])",
                options.azimuth,
                options.elevation,
                options.zoom,
            )
            for frame in options.frames or [count - 1]:
                index = frame if frame >= 0 else count + frame
                # Two frames of the browser: layout settles in the first, the picture is on screen after the second.
                browser.run("pleatReport.frame = arguments[0]", index)
                browser.devtools(
                    "Runtime.evaluate",
                    {
                        "expression": "new Promise(done => requestAnimationFrame(() => requestAnimationFrame(() => { pleatReport.render(); requestAnimationFrame(done); })))",
                        "awaitPromise": True,
                    },
                )
                path = options.out / f"{options.prefix}{view}-{index:04d}.png"
                path.write_bytes(browser.screenshot())
                print(path)
    return 0


if __name__ == "__main__":
    try:
        sys.exit(main())
    except (BrowserError, OSError) as failure:
        print(f"screenshot.py: {failure}", file=sys.stderr)
        sys.exit(1)
