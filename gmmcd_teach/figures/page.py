"""The page around every 3-D view: titles, legend with switches, keys, and a layout that fits narrow screens."""

TEMPLATE = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<link rel="icon" href="data:,">
<title>3-D view</title>
<style>
  html, body { margin: 0; background: @PAPER@; color: @INK@; font: 14px/1.4 system-ui, sans-serif; }
  body.framed { display: flex; flex-direction: column; height: 100vh; padding: 3px; box-sizing: border-box; }
  body.alone { max-width: 75rem; margin: 0 auto; padding: 0 .6rem; }
  .stage { position: relative; flex: 1; min-height: 0; }
  .alone .stage { height: 75vh; }
  .content { position: absolute; inset: 0; touch-action: pan-y pinch-zoom; }
  .content { outline: none; }
  .stage:has(.content:focus-visible) { box-shadow: 0 0 0 3px #0072b2; }
  .titles b { position: absolute; transform: translateX(-50%); padding-top: .2rem; pointer-events: none; }
  .legend { display: flex; flex-wrap: wrap; gap: .1rem .9rem; align-items: center; padding: .35rem .2rem .1rem; }
  .legend label { display: inline-flex; align-items: center; gap: .35rem; cursor: pointer; }
  .legend i { flex: none; width: 1.1rem; height: .8rem; border-radius: .15rem; box-shadow: 0 0 0 1px #8a9099; }
  .legend .panels { display: inline-flex; }
  .legend .panels button[aria-pressed="true"] { background: @INK@; color: #fff; }
  .legend button { border: 1px solid #8a9099; border-radius: .3rem; background: #fff; color: inherit; font: inherit; }
  .help { margin: 0; padding: 0 .2rem .2rem; font-size: 12px; color: #4a5058; }
  .blank { padding: 1rem; }
  @media print { .stage, .legend button, .help { display: none; } }
</style>
</head>
<body class="framed">
<div class="stage">
  <div class="content" tabindex="0" role="application"
       aria-label="@ALT@ Arrow keys turn the view, plus and minus zoom."></div>
  <div class="titles">@TITLES@</div>
</div>
<div class="legend" role="group" aria-label="Legend: switch each part on and off">
  @LEGEND@@PANELS@<button type="button">Reset view</button>
</div>
<p class="help">Drag to turn; click, then scroll to zoom; arrow keys turn, + and - zoom. @EXTENT@.</p>
<!--below-->
<script>
window.global = {};  // where the viewer leaves what it has drawn
(() => {
  const parts = @PARTS@, angle = @ANGLE@, aspect = @ASPECT@;  // what the camera was fitted to
  const find = selector => document.querySelector(selector);
  const stage = find(".stage"), content = find(".content"), titles = [...document.querySelectorAll(".titles b")];

  if (!document.createElement("canvas").getContext("webgl2")) {
    content.style.display = "none";
    const words = "No WebGL in this browser, so nothing turns here. Open the still picture instead.";
    stage.insertAdjacentHTML("beforeend", `<p class="blank">${words}</p>`);
    return;
  }

  // Scrolling past a view must not zoom it: the wheel is the view's only between a click and leaving it.
  let held = false;
  content.addEventListener("pointerdown", () => { held = true; }, true);
  content.addEventListener("pointerleave", () => { held = false; });
  addEventListener("wheel", event => {
    if (!held && content.contains(event.target)) event.stopImmediatePropagation();
  }, true);

  const begin = () => {
    const scene = window.global.renderWindow;
    const renderers = scene ? scene.getRenderers().slice(1) : [];  // the first is the viewer's own
    if (renderers.length < parts.length || renderers.some((r, i) => r.getActors().length < parts[i].length)) {
      requestAnimationFrame(begin);
      return;
    }
    scene.getRenderers()[0].setBackground(...renderers[0].getBackground());  // seen where no panel is
    const camera = renderers[0].getActiveCamera();
    renderers.forEach(renderer => renderer.setActiveCamera(camera));
    const home = [camera.getPosition(), camera.getFocalPoint(), camera.getViewUp()];
    const draw = () => { renderers.forEach(renderer => renderer.resetCameraClippingRange()); scene.render(); };

    let only = -1;  // the one panel that is shown, or -1 for all
    const layout = () => {
      const { clientWidth: width, clientHeight: height } = content, n = only < 0 ? parts.length : 1;
      if (!width || !height) return;
      const columns = Math.max(1, Math.min(n, Math.floor(width / 240))), rows = Math.ceil(n / columns);
      const band = Math.max(...titles.map(title => title.offsetHeight)) / height;  // titles stand above points
      renderers.forEach((renderer, panel) => {
        const shown = only < 0 || only === panel, i = only < 0 ? panel : 0;
        renderer.setDraw(shown);
        titles[panel].hidden = !shown;
        if (!shown) return;
        const left = (i % columns) / columns, top = Math.floor(i / columns) / rows;
        renderer.setViewport(left, 1 - top - 1 / rows, left + 1 / columns, 1 - top - band);
        titles[panel].style.cssText = `left:${100 * (left + 0.5 / columns)}%;top:${100 * top}%`;
      });
      const narrow = (width / columns) / (height * (1 / rows - band)) < aspect;
      camera.setUseHorizontalViewAngle(narrow);
      camera.setViewAngle(narrow ? 2 * Math.atan(aspect * Math.tan(angle / 2 * Math.PI / 180)) * 180 / Math.PI : angle);
      draw();
    };
    new ResizeObserver(() => requestAnimationFrame(layout)).observe(content);
    layout();

    find(".legend").addEventListener("change", event => {
      renderers.forEach((renderer, i) => renderer.getActors().forEach((actor, j) => {
        if (parts[i][j] === Number(event.target.value)) actor.setVisibility(event.target.checked);
      }));
      draw();
    });
    const choices = [...document.querySelectorAll(".panels button")];
    choices.forEach(button => {
      button.onclick = () => {
        only = Number(button.value);
        choices.forEach(other => other.setAttribute("aria-pressed", other === button));
        layout();
      };
    });
    find(".legend > button").onclick = () => {
      camera.setPosition(...home[0]); camera.setFocalPoint(...home[1]); camera.setViewUp(...home[2]);
      layout();
    };
    // The view turns about its upright axis and never tips over (degrees to the right and up).
    const turn = (right, up) => {
      const axis = home[2], sight = camera.getDirectionOfProjection();
      const sine = -axis.reduce((sum, x, i) => sum + x * sight[i], 0) / Math.hypot(...axis);
      const height = Math.asin(Math.min(Math.max(sine, -1), 1)) * 180 / Math.PI;
      camera.setViewUp(...axis);
      camera.azimuth(right);
      camera.elevation(Math.min(Math.max(height + up, -85), 85) - height);
    };
    // The viewer's own drag skips moves that come more than 200 ms apart, as on slow machines; this one does not.
    let last = null, asked = false;
    const drawSoon = () => {
      if (asked) return;
      asked = true;
      requestAnimationFrame(() => { asked = false; draw(); });
    };
    content.addEventListener("pointerdown", event => {
      const turns = event.pointerType !== "touch" && event.button === 0 && !event.shiftKey && !event.ctrlKey;
      if (!turns) return;
      event.stopPropagation();
      content.setPointerCapture(event.pointerId);
      content.focus({ preventScroll: true });
      last = event;
    }, true);
    content.addEventListener("pointermove", event => {
      if (!last) return;
      event.stopPropagation();
      const degrees = 180 / content.clientHeight;
      turn((last.clientX - event.clientX) * degrees, (event.clientY - last.clientY) * degrees);
      last = event;
      drawSoon();
    }, true);
    for (const end of ["pointerup", "pointercancel", "lostpointercapture"]) {
      content.addEventListener(end, () => { last = null; });
    }

    const moves = {
      ArrowLeft: () => turn(-6, 0), ArrowRight: () => turn(6, 0),
      ArrowUp: () => turn(0, 6), ArrowDown: () => turn(0, -6),
      "+": () => camera.dolly(1.1), "=": () => camera.dolly(1.1), "-": () => camera.dolly(1 / 1.1),
    };
    content.addEventListener("keydown", event => {
      if (!moves[event.key]) return;
      event.preventDefault();
      moves[event.key]();
      draw();
    });
  };
  begin();
})();
</script>
<script>
function loadDataSet() {
  OfflineLocalView.load(document.querySelector(".content"), { base64Str: "@SCENE@" });
}
</script>
<script type="module">@VIEWER@</script>
</body>
</html>
"""
