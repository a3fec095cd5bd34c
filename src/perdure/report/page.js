// Draws every figure from the specification beside it, in the colors of the page, and again when those change.
(function () {
  "use strict";
  var night = window.matchMedia("(prefers-color-scheme: dark)");
  var dark = JSON.parse(document.getElementById("dark").textContent);
  function draw() {
    document.querySelectorAll("figure").forEach(function (figure) {
      var spec = JSON.parse(figure.querySelector("script").textContent, function (key, value) {
        return night.matches && typeof value === "string" && Object.hasOwn(dark, value) ? dark[value] : value;
      });
      // The interpreter (ast) evaluates Vega's expressions, so that the page may forbid eval.
      var options = { actions: false, ast: true, defaultStyle: false, renderer: "svg" };
      options.tooltip = { theme: night.matches ? "dark" : "light" };
      vegaEmbed(figure.querySelector(".plot"), spec, options).catch(console.error);
    });
  }
  night.addEventListener("change", draw);
  draw();
})();
